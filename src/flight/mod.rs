//! Tracks and the latest calibration in, 3-D flight and pitch numbers out.
