//! The sRGB transfer curve (IEC 61966-2-1).

/// Linear [0, 1] to display [0, 1]. Not clamped.
pub fn linear_to_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// Inverse of [`linear_to_srgb`].
pub fn srgb_to_linear(display: f32) -> f32 {
    if display <= 0.040_45 { display / 12.92 } else { ((display + 0.055) / 1.055).powf(2.4) }
}

/// To 8 bits: clamped, rounded to nearest; NaN becomes 0.
pub(super) fn linear_to_srgb8(linear: f32) -> u8 {
    (linear_to_srgb(linear.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_8_bit_value_survives_decoding_and_encoding() {
        for value in 0..=255u8 {
            assert_eq!(linear_to_srgb8(srgb_to_linear(f32::from(value) / 255.0)), value);
        }
    }

    #[test]
    fn known_values_and_out_of_range_ones() {
        assert!((linear_to_srgb(0.18) - 0.461_356).abs() < 1e-5);
        assert!((srgb_to_linear(0.5) - 0.214_041).abs() < 1e-5);
        let clamped = [-1.0, f32::NAN, f32::NEG_INFINITY, 2.0, f32::INFINITY].map(linear_to_srgb8);
        assert_eq!(clamped, [0, 0, 0, 255, 255]);
    }
}
