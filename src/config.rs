//! Reads rig files.
