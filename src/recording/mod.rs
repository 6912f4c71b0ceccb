//! The on-disk session: writer, reader, repair; and track files.

mod track_files;

pub use track_files::{TrackFileError, read_track_file, read_track_folder, write_track_folder};
