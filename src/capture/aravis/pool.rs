//! Memory for frames, made beside the capture thread: two megabytes of new pages take milliseconds.

use crossbeam_channel::{Receiver, Sender, bounded, unbounded};

use super::ffi::touched_buffer;
use aravis::Buffer;

/// Buffers under way at once.
const ASKED_MOST: usize = 4;

/// A thread that makes buffers when they are asked for. It is made by an ordinary thread and stays one, so that a camera's
/// growing memory delays no frame.
pub struct BufferMaker {
    wanted: Sender<usize>,
    made: Receiver<(usize, Buffer)>,
    asked: usize,
}

impl BufferMaker {
    /// Starts the thread; without one there are no buffers over those that a camera begins with.
    pub fn new() -> Self {
        let (wanted, orders) = bounded::<usize>(ASKED_MOST);
        let (ready, made) = unbounded();
        let work = move || {
            for bytes in orders {
                if ready.send((bytes, touched_buffer(bytes))).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("camera-pool".to_owned());
        if let Err(error) = thread.spawn(work) {
            tracing::error!(%error, "no thread to make frames' memory");
        }
        Self {
            wanted,
            made,
            asked: 0,
        }
    }

    /// A buffer of this size that has been made meanwhile.
    pub fn take(&mut self, bytes: usize) -> Option<Buffer> {
        let (size, buffer) = self.made.try_recv().ok()?;
        self.asked = self.asked.saturating_sub(1);
        (size == bytes).then_some(buffer)
    }

    /// Asks for more of this size, up to `missing` in all; answers at once.
    pub fn ask(&mut self, bytes: usize, missing: usize) {
        while self.asked < missing.min(ASKED_MOST) && self.wanted.try_send(bytes).is_ok() {
            self.asked += 1;
        }
    }
}
