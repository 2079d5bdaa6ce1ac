//! The only conversions between SI units and the millimeters and degrees of configurations and tables.

/// Converts millimeters to meters.
pub fn mm(millimeters: f64) -> f64 {
    millimeters * 1e-3
}

/// Converts meters to millimeters.
pub fn to_mm(meters: f64) -> f64 {
    meters * 1e3
}

/// Converts degrees to radians.
pub fn deg(degrees: f64) -> f64 {
    degrees.to_radians()
}

/// Converts radians to degrees.
pub fn to_deg(radians: f64) -> f64 {
    radians.to_degrees()
}
