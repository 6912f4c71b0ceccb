//! Threads, channels, supervision; knows every room, contains no mathematics.

pub mod assemble;
pub mod batch;
pub mod clip_disk;
pub mod foresee;
pub mod health;
pub mod histogram;
pub mod looker;
pub mod outfit;
pub mod pipeline;
pub mod publish;
pub mod recorder;
pub mod supervise;
pub mod watch;
pub mod watcher;
