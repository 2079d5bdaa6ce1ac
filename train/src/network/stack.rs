//! Two images stacked along the channels, the input of FlowNetS.

use burn::tensor::{Tensor, TensorData};
use rayon::prelude::*;

use super::cpu::on_cpu;

/// Concatenates the channels of `first` and `second`. Not differentiable: images are data.
///
/// # Shapes
/// - `first`, `second`: `[batch, height, width, channels]`
/// - result: `[batch, height, width, 2 channels]`
pub(super) fn stacked(first: Tensor<4>, second: Tensor<4>) -> Tensor<4> {
    let device = first.device();
    if !on_cpu(&device) {
        return Tensor::cat(vec![first, second], 3);
    }
    // Burn's concatenation copies pixel by pixel on a single thread.
    let [batch, height, width, channels] = first.dims();
    let [first, second] = [first, second].map(Tensor::into_data);
    let [first, second] = [&first, &second].map(|data| data.as_slice::<f32>().expect("images are f32"));
    let mut both = vec![0.0; 2 * first.len()];
    let rows = first.par_chunks_exact(width * channels).zip(second.par_chunks_exact(width * channels));
    both.par_chunks_exact_mut(2 * width * channels).zip(rows).for_each(|(both, (first, second))| {
        let pixels = first.chunks_exact(channels).zip(second.chunks_exact(channels));
        for (both, (first, second)) in both.chunks_exact_mut(2 * channels).zip(pixels) {
            both[..channels].copy_from_slice(first);
            both[channels..].copy_from_slice(second);
        }
    });
    Tensor::from_data(TensorData::new(both, [batch, height, width, 2 * channels]), &device)
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::network::init::Init;

    #[test]
    fn is_the_concatenation() {
        let device = Device::default().autodiff();
        let [a, b] = [1, 2].map(|seed| Init::new(seed, &device).kaiming([2, 3, 5, 3], 6).val().detach());
        let expected = Tensor::cat(vec![a.clone(), b.clone()], 3);
        assert_eq!(stacked(a, b).into_data(), expected.into_data());
    }
}
