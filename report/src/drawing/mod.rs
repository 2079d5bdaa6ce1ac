//! Parts that all pictures share: SVG elements, charts, hemispheres.

pub mod chart;
pub mod figure;
pub(crate) mod hemisphere;
pub mod markup;
pub mod svg;
