//! The ball itself (domain §1).

/// Radius, metres: a circumference of 9⅛ inches.
pub const BALL_RADIUS_M: f64 = 0.036888;
/// Mass, kilograms: 5⅛ ounces.
pub const BALL_MASS_KG: f64 = 0.14529;
