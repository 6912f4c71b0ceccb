//! A frame in, ball detections out.
