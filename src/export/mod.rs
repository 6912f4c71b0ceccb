//! Statcast and TrackMan shaped files.
