//! The displacements of the correlation layer, those of the published FlowNetC.

/// Step between displacements in pixels.
pub(crate) const STRIDE: usize = 2;
/// Largest displacement along an axis in steps.
pub(crate) const REACH: usize = 10;
/// Displacements along an axis.
pub(crate) const SIDE: usize = 2 * REACH + 1;
/// All displacements: the channels of the result. A network of any width has all of them.
pub(crate) const DISPLACEMENTS: usize = SIDE * SIDE;
