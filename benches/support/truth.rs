//! What errors are measured against: a converged image whose own noise is known and taken off, or the other seeds.

use qtracer::Image;
use qtracer::film::{WriteOptions, read_image, write_image};
use std::path::{Path, PathBuf};

/// Relative mean squared error, its expectation from the reference's own noise subtracted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Over all pixels.
    pub plain: f64,
    /// Without the worst 0.1 % of the pixels (rounded down).
    pub trimmed: f64,
}

/// A converged image with its standard errors.
pub struct Reference {
    pub image: Image,
    /// For people and rows: where it is from.
    pub name: String,
}

/// Names under which tests/references and other collections keep the references of the shipped scenes.
const ALIASES: [(&str, &str); 5] = [
    ("cornell-box", "cornell"),
    ("bansal-room-1", "seed1"),
    ("bansal-room-5", "seed5"),
    ("door-ajar", "door"),
    ("glass-caustic", "caustic"),
];

/// The reference of a scene in a folder: `SCENE.exr` or its short name, if there is one.
pub fn find(folder: &Path, scene: &str) -> Option<PathBuf> {
    let alias = ALIASES.iter().find(|(name, _)| *name == scene).map(|(_, alias)| *alias);
    let names = [Some(scene), alias];
    names.iter().flatten().map(|name| folder.join(format!("{name}.exr"))).find(|path| path.exists())
}

impl Reference {
    /// Reads `PATH.exr`; its standard errors are in the file itself or beside it in `PATH.se.exr`. Where `size` is given and a
    /// whole fraction of the image's, blocks of pixels are averaged: with a box filter they are the pixels of the smaller
    /// image.
    pub fn read(path: &Path, size: Option<(u32, u32)>) -> Result<Reference, String> {
        let fault = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        let mut image = read_image(path).map_err(|error| fault(&error))?;
        let beside = path.with_extension("se.exr");
        if image.standard_error.is_none() && beside.exists() {
            let errors = read_image(&beside).map_err(|error| format!("{}: {error}", beside.display()))?;
            if (errors.width, errors.height) != (image.width, image.height) {
                return Err(format!("{} has another size than {}", beside.display(), path.display()));
            }
            image.standard_error = Some(errors.rgb);
        }
        if image.standard_error.is_none() {
            return Err(fault(&"has no standard errors, so what its own noise adds is not known"));
        }
        let (width, height) = size.unwrap_or((image.width, image.height));
        if (width, height) != (image.width, image.height) {
            image = shrink(&image, width, height).map_err(|error| fault(&error))?;
        }
        let name = path.file_stem().map_or(String::new(), |stem| stem.to_string_lossy().into_owned());
        Ok(Reference { image, name })
    }

    /// What the reference's own standard errors add to a relMSE against it.
    pub fn noise(&self, epsilon: f64) -> f64 {
        let noise = (0..self.image.rgb.len()).map(|i| self.pixel_noise(i, epsilon));
        noise.sum::<f64>() / self.image.rgb.len() as f64
    }

    fn pixel_noise(&self, pixel: usize, epsilon: f64) -> f64 {
        let Some(errors) = &self.image.standard_error else { return 0.0 };
        let channel = |c: usize| {
            let [error, value] = [errors[pixel][c], self.image.rgb[pixel][c]].map(f64::from);
            error * error / (value * value + epsilon)
        };
        (0..3).map(channel).sum::<f64>() / 3.0
    }

    /// The error of an image, minus what is the reference's own: in each pixel that counts.
    pub fn error_of(&self, rgb: &[[f32; 3]], epsilon: f64) -> Result<Noise, String> {
        let reference = &self.image.rgb;
        if rgb.len() != reference.len() {
            return Err(format!("{} pixels against a reference of {}", rgb.len(), reference.len()));
        }
        let pixel = |i: usize| {
            (squared_error(rgb[i], reference[i], reference[i], epsilon), self.pixel_noise(i, epsilon))
        };
        summarize((0..rgb.len()).map(pixel).collect())
    }
}

/// Means over blocks of pixels, errors added as those of independent pixels.
fn shrink(image: &Image, width: u32, height: u32) -> Result<Image, String> {
    let (have_width, have_height) = (image.width, image.height);
    let side = have_width / width.max(1);
    if side == 0 || height == 0 || (width * side, height * side) != (have_width, have_height) {
        return Err(format!("{have_width} x {have_height} pixels can't be averaged to {width} x {height}"));
    }
    let mut small = vec![([0.0f64; 3], [0.0f64; 3]); (width * height) as usize];
    let errors = image.standard_error.as_deref().unwrap_or_default();
    for (i, rgb) in image.rgb.iter().enumerate() {
        let (x, y) = (i as u32 % have_width, i as u32 / have_width);
        let (sum, variance) = &mut small[(y / side * width + x / side) as usize];
        for c in 0..3 {
            sum[c] += f64::from(rgb[c]);
            variance[c] += errors.get(i).map_or(0.0, |error| f64::from(error[c]).powi(2));
        }
    }
    let count = f64::from(side * side);
    let rgb = small.iter().map(|(sum, _)| sum.map(|v| (v / count) as f32)).collect();
    let error = small.iter().map(|(_, variance)| variance.map(|v| (v.sqrt() / count) as f32)).collect();
    Ok(Image { standard_error: Some(error), ..Image::new(width, height, rgb) })
}

/// Mean over the channels of (value − truth)² / (scale² + epsilon).
fn squared_error(value: [f32; 3], truth: [f32; 3], scale: [f32; 3], epsilon: f64) -> f64 {
    let channel = |c: usize| {
        let [v, t, s] = [value[c], truth[c], scale[c]].map(f64::from);
        (v - t).powi(2) / (s * s + epsilon)
    };
    (0..3).map(channel).sum::<f64>() / 3.0
}

/// The mean of (error − noise) over all pixels, and over all but those of the largest errors.
fn summarize(mut pixels: Vec<(f64, f64)>) -> Result<Noise, String> {
    if pixels.iter().any(|(error, _)| !error.is_finite()) {
        return Err("the image holds values that are no finite numbers".to_string());
    }
    let mean = |pixels: &[(f64, f64)]| {
        pixels.iter().map(|(error, noise)| error - noise).sum::<f64>() / pixels.len() as f64
    };
    let plain = mean(&pixels);
    pixels.sort_by(|a, b| a.0.total_cmp(&b.0));
    pixels.truncate(pixels.len() - pixels.len() / 1000);
    Ok(Noise { plain, trimmed: mean(&pixels) })
}

/// How far images of several seeds are from each other: for each the unbiased estimate of the variance, by squares relative to
/// `scale`. Tells nothing of a bias that all have.
pub fn scatter(images: &[Vec<[f32; 3]>], scale: &[[f32; 3]], epsilon: f64) -> Result<Vec<Noise>, String> {
    let n = images.len() as f64;
    if images.len() < 2 {
        return Err("seeds can only be compared with each other where there are two or more".to_string());
    }
    if images.iter().any(|image| image.len() != scale.len()) {
        return Err("images of different sizes".to_string());
    }
    let mean: Vec<[f64; 3]> = (0..scale.len())
        .map(|i| [0, 1, 2].map(|c| images.iter().map(|image| f64::from(image[i][c])).sum::<f64>() / n))
        .collect();
    let pixel = |image: &[[f32; 3]], i: usize| {
        let channel = |c: usize| {
            let (value, scale) = (f64::from(image[i][c]), f64::from(scale[i][c]));
            (value - mean[i][c]).powi(2) / (scale * scale + epsilon)
        };
        (n / (n - 1.0) * (0..3).map(channel).sum::<f64>() / 3.0, 0.0)
    };
    images.iter().map(|image| summarize((0..scale.len()).map(|i| pixel(image, i)).collect())).collect()
}

/// The mean of independent images of the same truth, with the standard error that their scatter shows.
pub fn self_made(images: &[Image]) -> Image {
    let (first, n) = (&images[0], images.len() as f64);
    let statistics = |i: usize, c: usize| {
        let values = || images.iter().map(|image| f64::from(image.rgb[i][c]));
        let mean = values().sum::<f64>() / n;
        let variance = values().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean as f32, (variance / n).sqrt() as f32)
    };
    let pixels = || 0..first.rgb.len();
    let rgb = pixels().map(|i| [0, 1, 2].map(|c| statistics(i, c).0)).collect();
    let error = pixels().map(|i| [0, 1, 2].map(|c| statistics(i, c).1)).collect();
    Image { standard_error: Some(error), ..Image::new(first.width, first.height, rgb) }
}

/// Writes an image that [`Reference::read`] reads.
pub fn write(path: &Path, image: &Image) -> Result<(), String> {
    write_image(path, image, &WriteOptions::default()).map_err(|error| format!("{}: {error}", path.display()))
}
