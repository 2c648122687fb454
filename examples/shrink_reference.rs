//! Averages an image over blocks of pixels, with its standard errors: how tests/references were made from the converged
//! images of another renderer. A pixel of the small image covers exactly one block, so a render at the small size (box
//! filter) estimates the same values.
//!
//! The samples of a block, those of all its pixels, are kept beside it.
//!
//! `cargo run --release --example shrink_reference -- IMAGE.exr IMAGE.se.exr SAMPLES SIDE OUTPUT.exr`, where SAMPLES is
//! how many samples a pixel of the image had and SIDE the side of a block. For tests/references: cornell 65536 8, door,
//! mesh and sky 32768 8, caustic 524288 8, seed1 32768 5, seed5 8192 5.

use qtracer::Image;
use qtracer::film::{WriteOptions, read_image, write_image};
use std::error::Error;
use std::path::Path;

/// Means over blocks of `side` × `side` pixels, which must fill the image.
fn block_means(image: &Image, side: u32, value: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
    let (columns, rows) = (image.width / side, image.height / side);
    let mut sums = vec![[0.0; 3]; (columns * rows) as usize];
    for (i, rgb) in image.rgb.iter().enumerate() {
        let (x, y) = (i as u32 % image.width, i as u32 / image.width);
        let sum = &mut sums[(y / side * columns + x / side) as usize];
        (0..3).for_each(|c| sum[c] += value(f64::from(rgb[c])));
    }
    sums.iter().map(|sum| sum.map(|v| v / f64::from(side * side))).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, errors, samples, side, output] = arguments.as_slice() else {
        return Err("usage: shrink_reference IMAGE ERRORS SAMPLES SIDE OUTPUT".into());
    };
    let (image, errors) = (read_image(Path::new(image))?, read_image(Path::new(errors))?);
    let (samples, side): (u32, u32) = (samples.parse()?, side.parse()?);
    if side == 0 || image.width % side != 0 || image.height % side != 0 {
        return Err(format!("blocks of {side} pixels do not fill {} x {}", image.width, image.height).into());
    }
    if (image.width, image.height) != (errors.width, errors.height) {
        return Err("image and errors differ in size".into());
    }
    let to_f32 =
        |values: Vec<[f64; 3]>| -> Vec<[f32; 3]> { values.iter().map(|v| v.map(|v| v as f32)).collect() };
    let mut small =
        Image::new(image.width / side, image.height / side, to_f32(block_means(&image, side, |v| v)));
    // Pixels are independent: the variance of a block's mean is the mean variance over the number of pixels.
    let mut variance = block_means(&errors, side, |v| v * v);
    variance.iter_mut().flatten().for_each(|v| *v = (*v / f64::from(side * side)).sqrt());
    small.standard_error = Some(to_f32(variance));
    small.samples = Some(vec![samples as f32 * (side * side) as f32; small.pixel_count()]);
    write_image(Path::new(output), &small, &WriteOptions::default())?;
    Ok(())
}
