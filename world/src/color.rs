//! Colors.

/// Red, green and blue in `[0, 1]`, as stored in images: light adds linearly, and no gamma is applied.
pub type Color = [f64; 3];
