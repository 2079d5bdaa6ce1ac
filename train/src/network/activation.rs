//! The activation of all networks: a leaky rectifier.

use serde::Serialize;

/// Slope for negative values, the same in the whole FlowNet family.
pub(crate) const SLOPE: f64 = 0.1;

/// An elementwise function.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Activation {
    /// Name of the function.
    pub kind: &'static str,
    /// Factor for negative values.
    pub slope: f64,
}

impl Activation {
    /// The leaky rectifier.
    pub(crate) const LEAKY: Self = Self { kind: "leaky_relu", slope: SLOPE };
}
