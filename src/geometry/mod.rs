//! Pure mathematics of cameras: pose, pinhole with distortion, two views, triangulation, alignment.
//!
//! Conventions (house rule, held by `tests/conventions.rs`): world coordinates are the home-plate frame
//! in metres; camera coordinates have x right, y down, z forward; a pose is `camera_from_world`,
//! `x_c = R·X_w + t`, and the camera's centre is `−Rᵀt`; **the centre of the top-left pixel is (0, 0)**.

mod alignment;
mod epipolar;
mod lens;
mod pose;
mod spline;
mod triangulation;

pub use alignment::{Similarity, align_similarity};
pub use epipolar::{cheirality, decompose_essential, essential_matrix, sampson_px};
pub use lens::{Intrinsics, LensError, Normalized, Pixel, PixelJacobian};
pub use pose::{Pose, rotation_from_vector, skew};
pub use spline::{PlaneSpline, SplineShape};
pub use triangulation::{TriangulationError, triangulate_dlt, triangulate_refined};
