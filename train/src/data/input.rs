//! Conversion of images to the input of a network, the same in training and in use.
//!
//! Larger images are downsampled by averaging over areas, which preserves the sub-pixel position of edges. That position is
//! the signal behind sub-millimeter accuracy at small inputs. Bytes are averaged as stored and rounded.

use burn::tensor::{Device, Tensor, TensorData};
use image::{ImageFormat, RgbImage};
use rayon::prelude::*;

use crate::error::{Error, Result};

/// Bytes per pixel.
const COLORS: usize = 3;

/// Returns the bytes of an input of this width and height.
pub(crate) fn bytes(input: [usize; 2]) -> usize {
    input[0] * input[1] * COLORS
}

/// Decodes a PNG image and downsamples it to the size of the input. Returns the pixels row by row, or the problem.
pub(crate) fn decode(png: &[u8], input: [usize; 2]) -> Result<Vec<u8>, String> {
    let image = image::load_from_memory_with_format(png, ImageFormat::Png).map_err(|e| e.to_string())?;
    downsample(&image.into_rgb8(), input).map_err(|e| e.to_string())
}

/// Downsamples an image to the size of the input. Returns the pixels row by row.
pub(crate) fn downsample(image: &RgbImage, input: [usize; 2]) -> Result<Vec<u8>> {
    let size = [image.width() as usize, image.height() as usize];
    if size == input {
        return Ok(image.as_raw().clone());
    }
    let same_aspect = size[0] * input[1] == size[1] * input[0];
    if !same_aspect || size[0] < input[0] {
        return Err(Error::ImageSize { image: size, input });
    }
    let columns: Vec<_> = (0..input[0]).map(|i| Window::new(i, size[0], input[0])).collect();
    // Rows first, so that the sums run over contiguous memory.
    let mut line = vec![0.0; size[0] * COLORS];
    let mut pixels = Vec::with_capacity(bytes(input));
    for i in 0..input[1] {
        line.fill(0.0);
        for (row, weight) in Window::new(i, size[1], input[1]).weights() {
            let row = &image.as_raw()[row * size[0] * COLORS..(row + 1) * size[0] * COLORS];
            line.iter_mut().zip(row).for_each(|(sum, &byte)| *sum += weight * f32::from(byte));
        }
        for column in &columns {
            for color in 0..COLORS {
                let mean: f32 = column.weights().map(|(j, weight)| weight * line[j * COLORS + color]).sum();
                pixels.push(mean.round() as u8);
            }
        }
    }
    Ok(pixels)
}

/// The interval of `from` pixels that pixel `index` of `to` pixels covers.
struct Window {
    begin: f64,
    end: f64,
}

impl Window {
    fn new(index: usize, from: usize, to: usize) -> Self {
        let edge = |index: usize| (index * from) as f64 / to as f64;
        Self { begin: edge(index), end: edge(index + 1) }
    }

    /// Returns the covered pixels, each with its fraction of the window.
    fn weights(&self) -> impl Iterator<Item = (usize, f32)> {
        let Self { begin, end } = *self;
        (begin.floor() as usize..end.ceil() as usize).map(move |pixel| {
            let covered = end.min((pixel + 1) as f64) - begin.max(pixel as f64);
            (pixel, (covered / (end - begin)) as f32)
        })
    }
}

/// Converts images to a tensor with values from -1 to 1, so that zero padding is gray.
///
/// # Shapes
/// - `images`: `height * width * 3` bytes each
/// - result: `[images, height, width, 3]`
pub(crate) fn tensor(images: &[&[u8]], [width, height]: [usize; 2], device: &Device) -> Tensor<4> {
    let mut values = vec![0.0; images.len() * bytes([width, height])];
    values.par_chunks_exact_mut(bytes([width, height])).zip(images).for_each(|(values, image)| {
        values
            .iter_mut()
            .zip(*image)
            .for_each(|(value, &byte)| *value = f32::from(byte) * (2.0 / 255.0) - 1.0);
    });
    Tensor::from_data(TensorData::new(values, [images.len(), height, width, COLORS]), device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_of_the_right_size_is_left_as_it_is() {
        let image = RgbImage::from_fn(4, 3, |x, y| image::Rgb([x as u8, y as u8, 200]));
        assert_eq!(downsample(&image, [4, 3]).unwrap(), image.into_raw());
    }

    #[test]
    fn pixels_are_means_of_areas() {
        let image = RgbImage::from_fn(4, 4, |x, y| image::Rgb([(10 * x) as u8, (20 * y) as u8, 7]));
        let expected = [[5, 10, 7], [25, 10, 7], [5, 50, 7], [25, 50, 7]].concat();
        assert_eq!(downsample(&image, [2, 2]).unwrap(), expected);
        // Three pixels to two: the middle one is shared. (0 + 60 / 2) / 1.5 = 20, (60 / 2 + 90) / 1.5 = 80.
        let image = RgbImage::from_fn(3, 3, |x, _| image::Rgb([[0, 60, 90][x as usize]; 3]));
        assert_eq!(downsample(&image, [2, 2]).unwrap(), [[20; 3], [80; 3], [20; 3], [80; 3]].concat());
    }

    #[test]
    fn neither_enlarges_nor_distorts() {
        let image = RgbImage::new(32, 24);
        assert!(downsample(&image, [64, 48]).unwrap_err().to_string().contains("32x24 pixels"));
        assert!(matches!(downsample(&image, [16, 16]), Err(Error::ImageSize { .. })));
        assert!(decode(b"no image", [32, 24]).is_err());
    }

    #[test]
    fn a_tensor_has_its_colors_last_and_is_centered() {
        let a: Vec<u8> = (0..18).collect();
        let b: Vec<u8> = (238..=255).collect();
        let tensor = tensor(&[&a, &b], [3, 2], &Device::flex());
        assert_eq!(tensor.dims(), [2, 2, 3, 3]);
        // Second row, first column, green: byte (1 * 3 + 0) * 3 + 1.
        for (image, byte) in [(0, 10.0), (1, 248.0)] {
            let value: f32 = tensor.clone().slice([image..image + 1, 1..2, 0..1, 1..2]).into_scalar();
            assert!((value - (byte - 127.5) / 127.5).abs() < 1e-6, "{value}");
        }
        let values: Vec<f32> = tensor.into_data().try_to_vec().unwrap();
        assert!(values[0].to_bits() == (-1.0_f32).to_bits() && (values[35] - 1.0).abs() < 1e-6);
    }
}
