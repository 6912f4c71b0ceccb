//! Frame numbers that only rise, from block ids that wrap and start anew.

/// More frames than this are not lost at once: the camera would have been given up long before. Such an id is garbage.
const JUMP_MAX: u64 = 20_000;

/// Unwraps one stream's block ids. GigE Vision 1.x counts 16 bits and skips zero; version 2 counts 64.
#[derive(Debug, Clone, Default)]
pub struct FrameNumber {
    last_id: Option<u64>,
    number: u64,
}

impl FrameNumber {
    /// Numbers go on after `number` (after a reconnection).
    pub fn after(number: u64) -> Self {
        Self {
            last_id: None,
            number,
        }
    }

    /// Whether no id has been seen yet.
    pub fn is_first(&self) -> bool {
        self.last_id.is_none()
    }

    /// The number of the frame with this id, and how many were lost right before it. An id that does not rise
    /// (a late frame, or a camera that started over) or jumps too far counts as the next frame.
    pub fn number(&mut self, id: u64) -> (u64, u64) {
        let step = match self.last_id {
            None => 1,
            Some(last) if id > last => id - last,
            // 65535 → 1 is one step; a fall by less than half the range is not a wrap.
            Some(last) if last <= 65535 && last - id > 32768 => id + 65535 - last,
            Some(_) => 1,
        };
        let step = if step > JUMP_MAX { 1 } else { step };
        self.last_id = Some(id);
        self.number = self.number.saturating_add(step);
        (self.number, step - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_wrap_from_65535_to_1() {
        let mut numbers = FrameNumber::default();
        assert_eq!(numbers.number(65533), (1, 0));
        assert_eq!(numbers.number(65535), (3, 1));
        assert_eq!(numbers.number(1), (4, 0));
        assert_eq!(numbers.number(5), (8, 3));
        // The camera started over.
        assert_eq!(numbers.number(1), (9, 0));
        assert_eq!(FrameNumber::after(70).number(12), (71, 0));
    }

    #[test]
    fn a_garbage_id_is_one_frame() {
        let mut numbers = FrameNumber::default();
        assert_eq!(numbers.number(10), (1, 0));
        assert_eq!(numbers.number(u64::MAX), (2, 0));
        assert_eq!(numbers.number(12), (3, 0));
        assert_eq!(numbers.number(14), (5, 1));
    }
}
