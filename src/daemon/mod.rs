//! Threads, channels, supervision; knows every room, contains no mathematics.
