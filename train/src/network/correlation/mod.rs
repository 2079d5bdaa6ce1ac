//! The correlation layer of FlowNetC (Dosovitskiy et al. 2015, Section 3, with the sizes of the published configuration):
//! the similarity of each pixel of one feature map and the pixels around it in another.
//!
//! On the CPU this is a custom operation. Elsewhere it is composed of Burn's operations as matrix products. Since
//! displacements are even, a pixel only meets pixels of its own row and column parity. The maps are therefore split into
//! four of half the size, on which displacements reach 10 in steps of 1. A product then compares every pixel of a band of
//! rows with every pixel within reach of the band, and the wanted values are diagonals of that product.
//!
//! For maps of `h x w` pixels and `c` channels, that costs `h w (w / 2 + 20) min(h / 2 + 20, 30) c` multiplications per image
//! instead of `441 h w c` (at 640 x 480: 2.2 instead of 0.54 billion, of 20 billion in the network), and memory for the
//! products of one band, 20 rows of `h`.

mod cpu;
pub(crate) mod displacement;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, backend_extension};
use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;
use burn_flex::FlexTensor;

use self::cpu::Side;
use self::displacement::{DISPLACEMENTS, REACH, SIDE, STRIDE};
use super::cpu::{dims, on_cpu, tensor, values};

/// Rows of a band, in the maps of one parity.
const BAND: usize = 10;

/// Correlates two feature maps. Channel `21 i + j` is the mean over the channels of `a` at each pixel times `b` displaced by
/// `(2 i - 20, 2 j - 20)` rows and columns; zero outside.
///
/// # Shapes
/// - `a`, `b`: `[batch, height, width, channels]`
/// - result: `[batch, height, width, 441]`
pub(super) fn correlation(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    if on_cpu(&a.device()) {
        return Tensor::from_dispatch(<Dispatch as Correlation>::correlation(
            a.into_dispatch(),
            b.into_dispatch(),
        ));
    }
    composed(a, b)
}

/// The operation as an extension of Burn's CPU backend.
#[backend_extension(Autodiff, Flex)]
trait Correlation: Backend {
    fn correlation(a: FloatTensor<Self>, b: FloatTensor<Self>) -> FloatTensor<Self>;
}

impl Correlation for Flex {
    fn correlation(a: FlexTensor, b: FlexTensor) -> FlexTensor {
        let [batch, height, width, channels] = dims(&a);
        let [a, b] = [a, b].map(|map| map.to_contiguous());
        let output = cpu::forward([batch, height, width, channels], values(&a), values(&b));
        tensor(output, [batch, height, width, DISPLACEMENTS])
    }
}

impl<C: CheckpointStrategy> Correlation for Autodiff<Flex, C> {
    fn correlation(a: FloatTensor<Self>, b: FloatTensor<Self>) -> FloatTensor<Self> {
        let ((a, a_node), (b, b_node)) = (a.into_parts(), b.into_parts());
        let output = Flex::correlation(a.clone(), b.clone());
        match CorrelationBackward.prepare::<C>([a_node, b_node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish([a, b], output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }
}

#[derive(Debug)]
struct CorrelationBackward;

impl Backward<Flex, 2> for CorrelationBackward {
    type State = [FlexTensor; 2];

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let [a, b] = ops.state.map(|map| map.to_contiguous());
        let shape = dims(&a);
        let gradient = grads.consume::<Flex>(&ops.node).to_contiguous();
        for (node, (side, other)) in ops.parents.into_iter().zip([(Side::First, b), (Side::Second, a)]) {
            if let Some(node) = node {
                let gradient = cpu::gradient(shape, side, values(&gradient), values(&other));
                grads.register::<Flex>(node.id, tensor(gradient, shape));
            }
        }
    }
}

/// [`correlation`] composed of Burn's operations.
fn composed(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    let [batch, height, width, channels] = a.dims();
    // `diagonals` needs one more row and column.
    let a = parities(a / channels as f32).pad([(0, 1), (0, 1), (0, 0)], PadMode::Constant(0.0));
    let b = parities(b).pad([(REACH, REACH), (REACH, REACH), (0, 0)], PadMode::Constant(0.0));
    let [rows, columns] = [height, width].map(|size| size.div_ceil(STRIDE));
    let maps = batch * STRIDE * STRIDE;
    let bands = (0..rows).step_by(BAND).map(|first| {
        let band = BAND.min(rows - first);
        let here = a.clone().narrow(1, first, band + 1).flatten::<3>(1, 2);
        let there = b.clone().narrow(1, first, band + 2 * REACH).flatten::<3>(1, 2);
        let products = here.matmul(there.transpose());
        let products = products.reshape([maps, band + 1, columns + 1, band + 2 * REACH, columns + 2 * REACH]);
        let products = diagonals(products);
        let products = products.reshape([maps * band, columns + 1, SIDE, columns + 2 * REACH, 1]);
        diagonals(products).reshape([maps, band, columns, DISPLACEMENTS])
    });
    let maps = Tensor::cat(bands.collect(), 1);
    let whole =
        maps.reshape([batch, STRIDE, STRIDE, rows, columns, DISPLACEMENTS]).permute([0, 3, 1, 4, 2, 5]);
    let whole = whole.reshape([batch, rows * STRIDE, columns * STRIDE, DISPLACEMENTS]);
    whole.narrow(1, 0, height).narrow(2, 0, width)
}

/// Splits a map into four of half the size, one for each parity of row and column.
///
/// # Shapes
/// - `map`: `[batch, height, width, channels]`
/// - result: `[4 batch, ceil(height / 2), ceil(width / 2), channels]`
fn parities(map: Tensor<4>) -> Tensor<4> {
    let [batch, height, width, channels] = map.dims();
    let [rows, columns] = [height, width].map(|size| size.div_ceil(STRIDE));
    let missing = [(0, rows * STRIDE - height), (0, columns * STRIDE - width), (0, 0)];
    let even = map.pad(missing, PadMode::Constant(0.0));
    let apart = even.reshape([batch, rows, STRIDE, columns, STRIDE, channels]).permute([0, 2, 4, 1, 3, 5]);
    apart.reshape([batch * STRIDE * STRIDE, rows, columns, channels])
}

/// Extracts `result[n, l, j, i, k] = band[n, l, j, l + i, k]`. A step in `l` together with a step in `i` is a constant
/// distance in memory, so it suffices to view the rows as one element longer than they are.
///
/// # Shapes
/// - `band`: `[n, l + 1, j, l + 20, k]`, where the last entry of the second dimension is ignored
/// - result: `[n, l, j, 21, k]`
fn diagonals(band: Tensor<5>) -> Tensor<5> {
    let [n, more, j, reach, k] = band.dims();
    let (l, row) = (more - 1, j * reach * k);
    let skewed = band.flatten::<2>(1, 4).narrow(1, 0, l * (row + k)).reshape([n, l, row + k]);
    skewed.narrow(2, 0, row).reshape([n, l, j, reach, k]).narrow(3, 0, SIDE)
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData, Tolerance};

    use super::*;
    use crate::network::init::Init;

    const FORMS: [fn(Tensor<4>, Tensor<4>) -> Tensor<4>; 2] = [correlation, composed];

    /// Values in -1..1.
    fn noise(shape: [usize; 4], seed: u64) -> Vec<f32> {
        Init::new(seed, &Device::flex()).kaiming(shape, 6).val().into_data().try_to_vec().unwrap()
    }

    /// The definition, written out.
    fn naive(a: &[f32], b: &[f32], [batch, height, width, channels]: [usize; 4]) -> Vec<f32> {
        let mut result = Vec::new();
        let pixels =
            (0..batch * height * width).map(|p| [p / (height * width), p / width % height, p % width]);
        for [image, y, x] in pixels {
            for displacement in 0..DISPLACEMENTS {
                let there_y = (y + 2 * (displacement / 21)).wrapping_sub(20);
                let there_x = (x + 2 * (displacement % 21)).wrapping_sub(20);
                let at = |y, x| ((image * height + y) * width + x) * channels;
                let inside = there_y < height && there_x < width;
                let sum = |c: usize| a[at(y, x) + c] * b[at(there_y, there_x) + c];
                result.push(if inside { (0..channels).map(sum).sum::<f32>() / channels as f32 } else { 0.0 });
            }
        }
        result
    }

    #[test]
    fn agrees_with_its_definition() {
        // Maps smaller than the reach, wider than it, of odd sizes, and of several bands.
        for shape in [[2, 6, 8, 3], [1, 3, 47, 2], [3, 1, 1, 4], [2, 45, 5, 1], [1, 40, 42, 2], [1, 4, 5, 37]]
        {
            let (a, b) = (noise(shape, 1), noise(shape, 2));
            let expected = naive(&a, &b, shape);
            let [batch, height, width, _] = shape;
            let expected = TensorData::new(expected, [batch, height, width, DISPLACEMENTS]);
            let [a, b] = [a, b].map(|v| Tensor::<4>::from_data(TensorData::new(v, shape), &Device::flex()));
            for form in FORMS {
                let found = form(a.clone(), b.clone()).into_data();
                found.assert_approx_eq::<f32>(&expected, Tolerance::rel_abs(1e-5, 1e-6));
            }
        }
    }

    /// The result is linear in each map, so differences of `sum(g * correlation(a, b))` equal its gradients.
    #[test]
    fn gradients_match_differences() {
        let shape = [2, 5, 23, 2];
        let device = Device::flex().autodiff();
        let (a, b) = (noise(shape, 1), noise(shape, 2));
        let weights = noise([2, 5, 23, DISPLACEMENTS], 3);
        let value = |a: &[f32], b: &[f32]| -> f64 {
            naive(a, b, shape).iter().zip(&weights).map(|(v, w)| f64::from(v * w)).sum()
        };
        let tensor = |values: &[f32], shape: [usize; 4]| {
            Tensor::<4>::from_data(TensorData::new(values.to_vec(), shape), &device)
        };
        for form in FORMS {
            let [x, y] = [&a, &b].map(|values| tensor(values, shape).require_grad());
            let output = form(x.clone(), y.clone());
            let dims = output.dims();
            let gradients = (output * tensor(&weights, dims)).sum().backward();
            let [x, y] = [x, y].map(|t| t.grad(&gradients).unwrap().into_data().try_to_vec::<f32>().unwrap());
            for i in (0..a.len()).step_by(7) {
                let moved = |values: &[f32], by: f32| {
                    let mut values = values.to_vec();
                    values[i] += by;
                    values
                };
                let of_a = value(&moved(&a, 0.5), &b) - value(&moved(&a, -0.5), &b);
                let of_b = value(&a, &moved(&b, 0.5)) - value(&a, &moved(&b, -0.5));
                assert!((of_a - f64::from(x[i])).abs() < 1e-4, "a {i}: {of_a} {}", x[i]);
                assert!((of_b - f64::from(y[i])).abs() < 1e-4, "b {i}: {of_b} {}", y[i]);
            }
        }
    }
}
