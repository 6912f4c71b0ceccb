//! Threads, channels, supervision; knows every room, contains no mathematics.

pub mod assemble;
pub mod ball;
pub mod batch;
pub mod calibrating;
pub mod clip_disk;
pub mod ending;
pub mod foresee;
pub mod health;
pub mod histogram;
pub mod keep;
pub mod lockstep;
pub mod looker;
pub mod memory_lock;
pub mod outfit;
pub mod pipeline;
pub mod plates;
pub mod publish;
pub mod recorder;
pub mod sky;
pub mod supervise;
pub mod watch;
pub mod watcher;
