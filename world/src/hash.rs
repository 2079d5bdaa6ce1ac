//! Random bits as a function of position, for textures and camera noise. They can be computed in any order.

/// Mixes 64 bits so that neighboring inputs have unrelated outputs: the output function of `SplitMix64` (Steele, Lea and
/// Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
pub(crate) fn hash(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Turns random bits into three numbers in `[-1, 1)`.
pub(crate) fn signed(bits: u64) -> [f64; 3] {
    [0, 21, 42].map(|shift| (bits >> shift & 0x1f_ffff) as f64 / f64::from(1 << 20) - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multiples_of_the_golden_ratio_give_the_published_sequence() {
        // The widely used test vector of the generator: its first outputs for seed 1234567.
        let expected = [6_457_827_717_110_365_317_u64, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        let outputs = [1_u64, 2, 3].map(|i| hash(1_234_567 + i.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        assert_eq!(outputs, expected);
    }
}
