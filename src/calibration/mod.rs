//! Tracks in, delays and poses out.
