//! The difference of two images as an image.

use qtracer::Image;
use qtracer::film::{ImageError, WriteOptions, false_colour, luminance, write_image};
use std::path::Path;

/// ε of the relative difference, so that black pixels do not shout.
const EPSILON: f32 = 0.01;

/// `.exr`: A − B per channel, signed. `.png`: [`false_colour`] of the relative difference of luminance, full at `range`.
/// The images have one size.
pub fn write(path: &Path, a: &Image, b: &Image, range: f32) -> Result<(), ImageError> {
    let is_exr = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr"));
    let pixel = |(a, b): (&[f32; 3], &[f32; 3])| match is_exr {
        true => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
        false => false_colour(relative(*a, *b) / range),
    };
    let rgb = a.rgb.iter().zip(&b.rgb).map(pixel).collect();
    write_image(path, &Image::new(a.width, a.height, rgb), &WriteOptions::default())
}

fn relative(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [a, b] = [a, b].map(|rgb| luminance(rgb.map(f64::from)) as f32);
    (a - b) / (b.abs() + EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brighter_is_red_darker_blue_equal_black_and_no_number_green() {
        let grey = [0.5; 3];
        assert_eq!(false_colour(relative(grey, grey)), [0.0; 3]);
        assert!(false_colour(relative([0.6; 3], grey))[0] > 0.1);
        assert!(false_colour(relative([0.4; 3], grey))[2] > 0.1);
        assert_eq!(false_colour(relative([f32::NAN; 3], grey)), [0.0, 1.0, 0.0]);
        assert_eq!(false_colour(f32::INFINITY)[0], 1.0);
    }
}
