//! Threads, channels, supervision; knows every room, contains no mathematics.

pub mod batch;
pub mod watch;
