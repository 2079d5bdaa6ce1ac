//! The convolution of all networks: convolution, bias and leaky rectifier.
//!
//! [`ConvBlock`] holds the parameters, `leaky_conv` is the differentiable operation, and `passes` its forward and
//! backward passes on the CPU. A pass is split into tiles of pixels that fit the cache (`tiled_pass`), and each tile is
//! multiplied by a micro-kernel that keeps its sums in registers (`micro_kernel`).

mod block;
mod leaky_conv;
mod micro_kernel;
mod passes;
mod tiled_pass;

pub(crate) use self::block::{ConvBlock, through};
#[cfg(test)]
pub(crate) use self::leaky_conv::leaky_conv2d;
