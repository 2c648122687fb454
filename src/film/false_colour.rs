//! Signed values as colours.

/// Red above 0, blue below, black at 0, full at ±1 and beyond; green for what is no number.
pub fn false_colour(value: f32) -> [f32; 3] {
    let strength = value.abs().min(1.0);
    match value {
        v if v.is_nan() => [0.0, 1.0, 0.0],
        v if v > 0.0 => [strength, 0.1 * strength, 0.0],
        _ => [0.0, 0.1 * strength, strength],
    }
}
