//! What the film takes: radiance that can be added up. GPU twin: kernels/stages/resolve.wesl

use glam::Vec3;

/// 2⁶⁰. 32 squares of less are finite in f32. Radiances of scenes end at 1e15, a thousandth of it: only weights of paths get a
/// sample there, such as colours above 1 or roulette at a small scale.
pub const BRIGHTEST: f32 = (1u64 << 60) as f32;

/// Whether the film can count the sample: no channel is NaN, infinite or beyond what its square can be. Judged by bits, as on
/// GPUs, whose compilers may assume that there is no NaN.
pub fn is_countable(radiance: Vec3) -> bool {
    radiance.to_array().iter().all(|value| value.to_bits() & !SIGN < BRIGHTEST.to_bits())
}

const SIGN: u32 = 1 << 31;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_infinite_or_absurd_is_not_counted_in_any_channel() {
        let below = f32::from_bits(BRIGHTEST.to_bits() - 1);
        for good in [0.0, -0.0, 1e-45, 1.0, -1.0, 1e15, below, -below] {
            assert!(is_countable(Vec3::splat(good)), "{good}");
        }
        let signalling = f32::from_bits(0x7f80_0001);
        for bad in [f32::NAN, -f32::NAN, signalling, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, BRIGHTEST] {
            for channel in 0..3 {
                let mut radiance = Vec3::ONE;
                radiance[channel] = bad;
                assert!(!is_countable(radiance), "{bad} in channel {channel}");
            }
        }
    }

    #[test]
    fn a_block_of_the_brightest_squares_is_finite() {
        let square = f32::from_bits(BRIGHTEST.to_bits() - 1).powi(2);
        assert!((0..32).map(|_| square).sum::<f32>().is_finite());
    }
}
