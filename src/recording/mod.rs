//! The on-disk session: writer, reader, repair.
