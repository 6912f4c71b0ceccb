//! Detections in, 2-D tracks out, one camera at a time.
