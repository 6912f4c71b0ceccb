//! The daemon's end: its threads are waited for, but not for ever.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// With the longest flight before it, below the unit's `TimeoutStopSec` of 30 s: the assembler gives a calibration 20 s.
pub const STOP_MOST: Duration = Duration::from_secs(25);

/// `print` may be blocked by a reader that stands still; `calibrate` works for `assemble`, which waits for it as long as
/// that makes sense.
const NOT_WAITED_FOR: [&str; 2] = ["print", "calibrate"];

/// Waits until the threads have ended, at most this long for all of them together; answers the names of those that are
/// still at work then (a disk that stands still). They are left to the process's end.
pub fn join_all(threads: Vec<JoinHandle<()>>, most: Duration) -> Vec<String> {
    let until = Instant::now() + most;
    let name = |thread: &JoinHandle<()>| thread.thread().name().unwrap_or_default().to_owned();
    let mut at_work = threads;
    at_work.retain(|thread| !NOT_WAITED_FOR.contains(&name(thread).as_str()));
    loop {
        let (ended, rest): (Vec<_>, Vec<_>) = at_work.into_iter().partition(JoinHandle::is_finished);
        at_work = rest;
        for thread in ended {
            let name = name(&thread);
            if thread.join().is_err() {
                tracing::error!("`{name}` ended by a panic");
            }
        }
        if at_work.is_empty() || Instant::now() >= until {
            return at_work.iter().map(name).collect();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[cfg(test)]
mod tests {
    use crossbeam_channel::{Receiver, bounded};

    use super::*;

    /// A thread that works until told to end.
    fn thread(name: &str, end: &Receiver<()>) -> JoinHandle<()> {
        let end = end.clone();
        let work = move || {
            let _ = end.recv();
        };
        std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(work)
            .unwrap()
    }

    #[test]
    fn a_thread_that_never_ends_is_named_and_left() {
        let (never_in, never) = bounded(0);
        let (ended_in, ended) = bounded(0);
        drop(ended_in);
        let threads = || {
            vec![
                thread("assemble", &ended),
                thread("disk", &never),
                thread("print", &never),
                thread("calibrate", &never),
            ]
        };
        let begun = Instant::now();
        assert_eq!(join_all(threads(), Duration::from_millis(200)), ["disk"]);
        let took = begun.elapsed();
        assert!(took >= Duration::from_millis(200), "it was waited for: {took:?}");
        assert!(took < Duration::from_secs(5), "and not for ever: {took:?}");

        // Those that nobody waits for hold up nothing.
        let begun = Instant::now();
        let threads = vec![thread("assemble", &ended), thread("print", &never)];
        assert!(join_all(threads, Duration::from_secs(60)).is_empty());
        assert!(begun.elapsed() < Duration::from_secs(30));
        drop(never_in);
    }
}
