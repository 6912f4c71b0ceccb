//! Keeps the daemon's memory out of swap: a frame's buffer that must come from the disk first is a frame too late.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, capabilities};

/// Why memory stays as it is.
#[derive(Debug, thiserror::Error)]
pub enum MemoryLockError {
    /// The limit is below what there will be: with it, new memory would be refused.
    #[error(
        "memory is not locked and may be swapped out: the limit is {limit_bytes} bytes; \
         LimitMEMLOCK=infinity in the unit, or ulimit -l unlimited"
    )]
    Limit {
        /// The limit.
        limit_bytes: u64,
    },
    /// The system refuses.
    #[error("memory is not locked and may be swapped out: {0}")]
    System(std::io::Error),
}

/// Locks all memory, now and later, each page as it is first touched: reserved stacks cost nothing. Only where any amount
/// may be locked: with a limit, memory that is asked for later would be refused.
///
/// # Errors
/// [`MemoryLockError`]; nothing has changed then.
pub fn lock_memory() -> Result<(), MemoryLockError> {
    let privileged = capabilities(None).is_ok_and(|own| own.effective.contains(CapabilitySet::IPC_LOCK));
    if let Some(limit_bytes) = getrlimit(Resource::Memlock).current.filter(|_| !privileged) {
        return Err(MemoryLockError::Limit { limit_bytes });
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT)
        .map_err(|error| MemoryLockError::System(error.into()))
}
