//! Where frames come from: one trait.
