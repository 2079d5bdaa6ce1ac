//! Burn's CPU backend, for which the convolution and the correlation are custom operations.

use burn::tensor::{Device, TensorData};
use burn_flex::FlexTensor;

/// Returns whether a device uses the custom operations.
pub(crate) fn on_cpu(device: &Device) -> bool {
    *device == Device::flex()
}

/// Returns the shape of a tensor.
pub(super) fn dims<const D: usize>(tensor: &FlexTensor) -> [usize; D] {
    tensor.layout().shape().dims()
}

/// Returns the elements of a contiguous tensor.
pub(super) fn values(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice().expect("the caller made it contiguous")
}

/// Makes a tensor of its elements.
pub(super) fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}
