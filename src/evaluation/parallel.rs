//! Independent pieces of a study on all cores, answers in order.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

/// `work(0)` … `work(count − 1)` on as many threads as the machine has cores. The answers are in order and do not
/// depend on the number of threads; `progress` hears, on this thread, how many are done.
pub(super) fn each<T: Send>(
    count: usize,
    work: impl Fn(usize) -> T + Sync,
    mut progress: impl FnMut(usize),
) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let (answer, answers) = mpsc::channel();
    let mut all: Vec<Option<T>> = (0..count).map(|_| None).collect();
    std::thread::scope(|scope| {
        for _ in 0..threads.min(count) {
            let (answer, next, work) = (answer.clone(), &next, &work);
            scope.spawn(move || {
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k >= count || answer.send((k, work(k))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(answer);
        for (done, (k, found)) in (1..).zip(answers) {
            if let Some(place) = all.get_mut(k) {
                *place = Some(found);
            }
            progress(done);
        }
    });
    all.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_in_order_and_each_is_heard_of_once() {
        let mut heard = Vec::new();
        let squares = each(100, |k| k * k, |done| heard.push(done));
        assert_eq!(squares, (0..100).map(|k| k * k).collect::<Vec<_>>());
        assert_eq!(heard, (1..=100).collect::<Vec<_>>());
        assert!(each(0, |k| k, |_| ()).is_empty());
    }
}
