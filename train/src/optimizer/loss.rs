//! The loss of both networks.

use burn::tensor::Tensor;

/// Returns the squared error, averaged over the batch and the components.
///
/// For `CNN_avoid` this is the loss of Section 4.2, `1/N sum (G_n - G^_n)^2`. For `CNN_approach` it is a sixth of the loss
/// of Section 4.1, `|dx - dx^|^2`, with each axis in units of its own scale: the paper adds squared meters and squared
/// angles and does not state the units.
///
/// # Shapes
/// - `predicted`, `target`: `[batch, components]`
/// - result: `[1]`
pub fn mean_squared_error(predicted: Tensor<2>, target: Tensor<2>) -> Tensor<1> {
    let difference = predicted - target;
    (difference.clone() * difference).mean()
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn is_the_mean_of_squares() {
        let device = Device::flex();
        let predicted = Tensor::from_floats([[1.0, 2.0, 0.0], [0.0, -1.0, 4.0]], &device);
        let target = Tensor::from_floats([[0.0, 2.0, 2.0], [0.0, 0.0, 1.0]], &device);
        assert_relative_eq!(mean_squared_error(predicted, target).into_scalar::<f32>(), 15.0 / 6.0);
    }
}
