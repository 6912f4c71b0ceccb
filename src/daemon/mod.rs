//! Threads, channels, supervision; knows every room, contains no mathematics.

pub mod assemble;
pub mod batch;
pub mod health;
pub mod pipeline;
pub mod publish;
pub mod supervise;
pub mod watch;
pub mod watcher;
