//! The log's way to standard error: through a queue, so that a reader that stands still (a pager, a journal on a dead disk)
//! holds up no thread that logs.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use tracing_subscriber::fmt::MakeWriter;

/// Lines that may wait; those beyond are lost, and counted.
const LINES: usize = 4096;
/// The program's end waits so long for a reader.
const LAST: Duration = Duration::from_secs(1);

enum Entry {
    Line(Vec<u8>),
    /// All before this has been written.
    End(Sender<()>),
}

/// Where log lines go.
#[derive(Clone)]
pub struct LogQueue {
    entries: Sender<Entry>,
    lost: Arc<AtomicU64>,
}

impl LogQueue {
    /// Begins to write to this.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn start(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (entries, queued) = bounded(LINES);
        let lost = Arc::new(AtomicU64::new(0));
        let lost_lines = lost.clone();
        std::thread::Builder::new()
            .name("log".to_owned())
            .spawn(move || write_all(out, &queued, &lost_lines))?;
        Ok(Self { entries, lost })
    }

    /// Waits until what was logged has been written, a second at most.
    pub fn finish(&self) {
        let (done, written) = bounded(1);
        if self.entries.send_timeout(Entry::End(done), LAST).is_ok() {
            let _ = written.recv_timeout(LAST);
        }
    }
}

impl Write for LogQueue {
    /// Never fails: a log that cannot be written is no reason to stop.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.entries.try_send(Entry::Line(line.to_vec())).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for LogQueue {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

fn write_all(mut out: impl Write, entries: &Receiver<Entry>, lost: &AtomicU64) {
    for entry in entries {
        // A reader that is gone: the lines go on being taken.
        match entry {
            Entry::Line(line) => drop(out.write_all(&line)),
            Entry::End(done) => {
                let _ = out.flush();
                let _ = done.send(());
            }
        }
        let missing = lost.swap(0, Ordering::Relaxed);
        if missing > 0 {
            let _ = writeln!(
                out,
                " WARN {missing} lines of the log were lost: nobody read them"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::time::Instant;

    /// A reader that stands still until told.
    #[derive(Clone)]
    struct Slow {
        go: Receiver<()>,
        read: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.go.recv();
            self.read.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_reader_that_stands_still_costs_lines_and_no_time() {
        let (go_in, go) = bounded(0);
        let read = Arc::new(Mutex::new(Vec::new()));
        let mut log = LogQueue::start(Slow {
            go,
            read: read.clone(),
        })
        .unwrap();
        let begun = Instant::now();
        for k in 0..LINES + 100 {
            log.write_all(format!("line {k}\n").as_bytes()).unwrap();
        }
        log.finish();
        // Twice a second at most, and not one of the reader's.
        assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
        drop(go_in);
        log.finish();
        let text = String::from_utf8(read.lock().unwrap().clone()).unwrap();
        assert!(
            text.starts_with("line 0\n") && text.contains("line 1\nline 2\n"),
            "{}",
            text.get(..40).unwrap_or(&text)
        );
        let lost: usize = text
            .lines()
            .filter_map(|l| l.strip_prefix(" WARN ")?.split(' ').next()?.parse::<usize>().ok())
            .sum();
        let came = text.lines().filter(|l| l.starts_with("line ")).count();
        assert_eq!(came + lost, LINES + 100);
        assert!((99..=100).contains(&lost), "{lost} lost");
    }
}
