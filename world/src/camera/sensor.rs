//! Imperfections of a real camera: blur and noise. Both use integer arithmetic.

use crate::hash::hash;
use image::RgbImage;
use serde::{Deserialize, Serialize};

/// Sum of the weights of a kernel. Relative weights are multiples of 1/65536.
const WHOLE: u32 = 1 << 16;

/// Imperfections of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Standard deviation of the Gaussian blur, from 0 to a few tens \[pixels\].
    pub blur: f64,
    /// Standard deviation of the noise, as a fraction of full scale.
    pub noise: f64,
}

impl Sensor {
    /// Blurs an image, with its border pixels replicated, and adds noise. The noise is a function of the seed and the position,
    /// independent for each channel of each pixel.
    pub fn expose(&self, image: &mut RgbImage, seed: u64) {
        if image.is_empty() || !(self.blur > 0.0 || self.noise > 0.0) {
            return;
        }
        // Bytes times 256, so that values are rounded only once.
        let mut values: Vec<u16> = image.iter().map(|byte| u16::from(*byte) << 8).collect();
        if self.blur > 0.0 {
            let kernel = kernel(self.blur);
            let length = 3 * image.width() as usize;
            blur_rows(&mut values, length, &kernel);
            blur_columns(&mut values, length, &kernel);
        }
        let noise = Noise::new(self.noise, seed);
        for ((place, byte), value) in (0..).zip(image.iter_mut()).zip(values) {
            *byte = ((i64::from(value) + noise.at(place) + 128) >> 8).clamp(0, 255) as u8;
        }
    }
}

/// Returns the weights of a pixel and of its neighbors on either side, which add up to [`WHOLE`]. They form a Gaussian,
/// `q^(i²)`, with q such that the discrete kernel has the given standard deviation.
fn kernel(deviation: f64) -> Vec<u32> {
    let reach = (4.0 * deviation).ceil() as usize;
    let weights = |q: f64| {
        // q^((i + 1)²) = q^(i²) q^(2i + 1).
        let mut next = (1.0, q);
        std::iter::repeat_with(move || {
            let (weight, ratio) = next;
            next = (weight * ratio, ratio * q * q);
            weight
        })
        .take(reach + 1)
    };
    let (mut least, mut greatest) = (0.0, 1.0);
    for _ in 0..60 {
        let q = 0.5 * (least + greatest);
        let (mut sum, mut moment) = (-0.5, 0.0);
        for (i, weight) in weights(q).enumerate() {
            sum += weight;
            moment += weight * (i * i) as f64;
        }
        if moment / sum < deviation * deviation { least = q } else { greatest = q }
    }
    let sum = 2.0 * weights(least).sum::<f64>() - 1.0;
    let mut kernel: Vec<u32> =
        weights(least).map(|weight| (weight / sum * f64::from(WHOLE) + 0.5) as u32).collect();
    kernel[0] = WHOLE - 2 * kernel[1..].iter().sum::<u32>();
    kernel
}

/// Blurs along the rows. Pixels have three channels.
fn blur_rows(values: &mut [u16], length: usize, kernel: &[u32]) {
    let reach = kernel.len() - 1;
    let mut wide = Vec::with_capacity(length + 6 * reach);
    let mut sums = vec![0; length];
    for row in values.chunks_exact_mut(length) {
        wide.clear();
        wide.extend(row[..3].iter().cycle().take(3 * reach));
        wide.extend_from_slice(row);
        wide.extend(row[length - 3..].iter().cycle().take(3 * reach));
        sums.fill(WHOLE / 2);
        for (i, weight) in kernel.iter().enumerate() {
            add(&mut sums, &wide[3 * (reach + i)..], *weight);
            if i > 0 {
                add(&mut sums, &wide[3 * (reach - i)..], *weight);
            }
        }
        settle(row, &sums);
    }
}

/// Blurs along the columns.
fn blur_columns(values: &mut [u16], length: usize, kernel: &[u32]) {
    let source = values.to_vec();
    let rows: Vec<&[u16]> = source.chunks_exact(length).collect();
    let mut sums = vec![0; length];
    for (y, row) in values.chunks_exact_mut(length).enumerate() {
        sums.fill(WHOLE / 2);
        for (i, weight) in kernel.iter().enumerate() {
            add(&mut sums, rows[(y + i).min(rows.len() - 1)], *weight);
            if i > 0 {
                add(&mut sums, rows[y.saturating_sub(i)], *weight);
            }
        }
        settle(row, &sums);
    }
}

/// Adds weighted values. No overflow: the greatest value, 255 times 256, times 65536, plus the half for rounding, is less than
/// 2³².
fn add(sums: &mut [u32], values: &[u16], weight: u32) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += weight * u32::from(*value);
    }
}

/// Rounds sums to values.
fn settle(values: &mut [u16], sums: &[u32]) {
    for (value, sum) in values.iter_mut().zip(sums) {
        *value = (sum / WHOLE) as u16;
    }
}

/// Nearly normal noise: the sum of eight random bytes. Its unit is 1/256 of a step between byte values.
struct Noise {
    key: u64,
    /// Factor of the sum, in units of 1/65536.
    scale: i64,
}

impl Noise {
    fn new(deviation: f64, seed: u64) -> Self {
        // Standard deviation of the sum of eight numbers uniform in 0 to 255.
        let of_sum = (8.0 * (256.0 * 256.0 - 1.0) / 12.0_f64).sqrt();
        let scale = deviation * 255.0 * 256.0 / of_sum * 65536.0 + 0.5;
        Self { key: hash(seed), scale: scale as i64 }
    }

    fn at(&self, place: u64) -> i64 {
        let bits = hash(self.key.wrapping_add(place.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        let low_bytes = 0x00ff_00ff_00ff_00ff;
        let pairs = (bits & low_bytes) + (bits >> 8 & low_bytes);
        let sum = pairs.wrapping_mul(0x0001_0001_0001_0001) >> 48;
        ((i64::from(sum as u16) - 1020) * self.scale + 32768) >> 16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// Cumulative normal distribution, by Simpson's rule.
    fn normal(x: f64) -> f64 {
        let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
        let step = x / 200.0;
        let sum: f64 = (0..100)
            .map(|i| 2.0 * f64::from(i) * step)
            .map(|t| density(t) + 4.0 * density(t + step) + density(t + 2.0 * step))
            .sum();
        0.5 + sum * step / 3.0
    }

    fn exposed(mut image: RgbImage, blur: f64, noise: f64, seed: u64) -> RgbImage {
        Sensor { blur, noise }.expose(&mut image, seed);
        image
    }

    /// Random bytes.
    fn clutter(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            Rgb(hash(u64::from(x) << 32 | u64::from(y)).to_le_bytes()[..3].try_into().unwrap())
        })
    }

    #[test]
    fn a_perfect_camera_changes_nothing() {
        let image = clutter(20, 10);
        assert_eq!(exposed(image.clone(), 0.0, 0.0, 1), image);
        assert_eq!(exposed(RgbImage::new(0, 0), 1.0, 0.1, 1), RgbImage::new(0, 0));
    }

    #[test]
    fn blur_keeps_a_constant_image_even_if_the_kernel_exceeds_it() {
        for (width, height) in [(1, 1), (2, 7), (40, 30)] {
            let image = RgbImage::from_pixel(width, height, Rgb([0, 77, 255]));
            for blur in [0.01, 0.3, 0.7, 3.0, 20.0] {
                assert_eq!(exposed(image.clone(), blur, 0.0, 1), image);
            }
        }
    }

    #[test]
    fn blur_keeps_the_mean() {
        let mut image = RgbImage::from_pixel(80, 80, Rgb([100, 0, 255]));
        image::imageops::replace(&mut image, &clutter(40, 40), 20, 20);
        let mean = |image: &RgbImage| image.iter().map(|byte| f64::from(*byte)).sum::<f64>() / 19200.0;
        assert!((mean(&exposed(image.clone(), 2.0, 0.0, 1)) - mean(&image)).abs() < 0.02);
    }

    #[test]
    fn a_kernel_is_a_gaussian_with_the_given_deviation() {
        for deviation in [0.2, 0.35, 0.5, 0.7, 1.0, 2.0, 5.0, 12.0] {
            let kernel = kernel(deviation);
            assert_eq!(kernel[0] + 2 * kernel[1..].iter().sum::<u32>(), WHOLE);
            let moment: f64 = (0_u32..).zip(&kernel).map(|(i, w)| f64::from(i * i * w)).sum();
            let found = (2.0 * moment / f64::from(WHOLE)).sqrt();
            assert!((found / deviation - 1.0).abs() < 3e-3, "{found} for {deviation}");
            if deviation >= 1.0 {
                for (i, weight) in kernel.iter().enumerate() {
                    let expected = (-0.5 * (i as f64 / deviation).powi(2)).exp() * f64::from(kernel[0]);
                    assert!((f64::from(*weight) - expected).abs() < 1e-3 * f64::from(kernel[0]));
                }
            }
        }
    }

    #[test]
    fn a_blurred_step_has_the_profile_of_the_error_function() {
        let across = RgbImage::from_fn(60, 9, |x, _| Rgb([if x < 30 { 20 } else { 220 }; 3]));
        let down = image::imageops::rotate90(&across);
        for blur in [1.2, 1.5, 2.5, 5.0] {
            let (across, down) = (exposed(across.clone(), blur, 0.0, 1), exposed(down.clone(), blur, 0.0, 1));
            for x in 0..60 {
                let expected = 20.0 + 200.0 * normal((f64::from(x) - 29.5) / blur);
                let found = f64::from(across.get_pixel(x, 4)[0]);
                assert!((found - expected).abs() < 1.6, "{blur}: {found} instead of {expected} at {x}");
                assert_eq!(across.get_pixel(x, 4), down.get_pixel(4, x));
            }
        }
    }

    #[test]
    fn noise_is_normal_white_and_as_strong_as_configured() {
        let image = RgbImage::from_pixel(300, 200, Rgb([128; 3]));
        for noise in [0.002, 0.01, 0.05] {
            let noisy = exposed(image.clone(), 0.0, noise, 3);
            // Rounding adds a variance of 1/12.
            let deviation = ((255.0 * noise).powi(2) + 1.0 / 12.0).sqrt();
            let z: Vec<f64> = noisy.iter().map(|byte| (f64::from(*byte) - 128.0) / deviation).collect();
            let mean = |f: &dyn Fn(usize) -> f64| (0..170_000).map(f).sum::<f64>() / 170_000.0;
            // Each tolerance is at least four standard deviations.
            assert!(mean(&|i| z[i]).abs() < 0.01);
            assert!((mean(&|i| z[i] * z[i]) - 1.0).abs() < 0.02);
            assert!(mean(&|i| z[i].powi(3)).abs() < 0.04);
            let fourth = mean(&|i| z[i].powi(4));
            assert!((2.7..3.1).contains(&fourth), "{fourth}");
            for apart in [1, 2, 3, 6, 900, 903] {
                assert!(mean(&|i| z[i] * z[i + apart]).abs() < 0.01, "{apart} apart");
            }
        }
    }

    #[test]
    fn noise_is_clipped_and_a_function_of_the_seed() {
        let image = RgbImage::from_pixel(40, 30, Rgb([0, 128, 255]));
        let noisy = |seed| exposed(image.clone(), 0.0, 0.02, seed);
        assert_eq!(noisy(1), noisy(1));
        let alike = noisy(1).pixels().zip(noisy(2).pixels()).filter(|(a, b)| a[1] == b[1]).count();
        assert!(alike < 150, "{alike} of 1200 pixels are alike");
        for pixel in noisy(1).pixels() {
            assert!(pixel[0] < 30 && pixel[2] > 225);
        }
    }
}
