//! The only conversion between SI and the millimetres and degrees of configurations and tables.

/// Millimetres to metres.
pub fn mm(millimetres: f64) -> f64 {
    millimetres * 1e-3
}

/// Metres to millimetres.
pub fn to_mm(metres: f64) -> f64 {
    metres * 1e3
}

/// Degrees to radians.
pub fn deg(degrees: f64) -> f64 {
    degrees.to_radians()
}

/// Radians to degrees.
pub fn to_deg(radians: f64) -> f64 {
    radians.to_degrees()
}
