//! Reading images. Files are data from anywhere: damaged, truncated or lying ones are errors, never a panic, and
//! never take memory out of proportion to their own size.

use std::fs;
use std::io::{self, Cursor};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageReader, Limits};

use super::exr_file::{self, DecodeError};
use super::srgb::srgb_to_linear;
use super::{Image, ImageError};
use crate::untrusted::{memory_for, unless_it_panics};

/// More pixels than this are taken for damage.
pub const MAX_PIXELS: usize = 1 << 28;

/// Reads .exr (ours with all layers; others' R, G, B), .png, .jpg (decoded from sRGB to linear) and .hdr.
/// The content decides, not the name.
pub fn read_image(path: &Path) -> Result<Image, ImageError> {
    let bytes = read_bytes(path).map_err(|source| ImageError::Read { path: path.into(), source })?;
    decode(&bytes).map_err(|error| explain(path, error))
}

impl Image {
    /// Decodes what [`read_image`] reads from files.
    pub fn from_bytes(bytes: &[u8]) -> Result<Image, ImageError> {
        decode(bytes).map_err(|error| explain(Path::new("memory"), error))
    }
}

fn decode(bytes: &[u8]) -> Result<Image, DecodeError> {
    let decode = || {
        if bytes.starts_with(&EXR_MAGIC) { decode_exr(bytes) } else { decode_other(bytes) }
    };
    unless_it_panics(DecodeError::Damaged("it is damaged".to_string()), decode)
}

/// Devices and pipes may have no end.
fn read_bytes(path: &Path) -> io::Result<Vec<u8>> {
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is no regular file"));
    }
    fs::read(path)
}

const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

fn explain(path: &Path, error: DecodeError) -> ImageError {
    let path = path.to_path_buf();
    match error {
        DecodeError::Damaged(reason) => ImageError::NotAnImage { path, reason },
        DecodeError::NoColour(found) => ImageError::NoColour { path, found },
        DecodeError::TooLarge(width, height) => {
            let reason = match plausible_pixels(width, height) {
                true => "more than its bytes can hold",
                false => "the limit is 2^28",
            };
            ImageError::TooLarge { path, width, height, reason }
        }
    }
}

fn plausible_pixels(width: usize, height: usize) -> bool {
    width.checked_mul(height).is_some_and(|pixels| pixels <= MAX_PIXELS)
}

/// Whether a file of `file_bytes` may ask for so many 4-byte samples.
fn plausible(file_bytes: usize, width: usize, height: usize, channels: usize) -> bool {
    let needed = width.saturating_mul(height).saturating_mul(channels).saturating_mul(4);
    plausible_pixels(width, height) && needed as u64 <= memory_for(file_bytes)
}

fn decode_exr(bytes: &[u8]) -> Result<Image, DecodeError> {
    exr_file::decode(bytes, |width, height, channels| plausible(bytes.len(), width, height, channels))
}

fn decode_other(bytes: &[u8]) -> Result<Image, DecodeError> {
    let damaged = |error: image::ImageError| DecodeError::Damaged(error.to_string());
    let unreadable = |error: io::Error| DecodeError::Damaged(error.to_string());
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(unreadable)?;
    if reader.format().is_none() {
        return Err(DecodeError::Damaged("it is no image of a known kind".to_string()));
    }
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(memory_for(bytes.len()));
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    if !plausible(bytes.len(), width as usize, height as usize, 3) {
        return Err(DecodeError::TooLarge(width as usize, height as usize));
    }
    Ok(to_linear(DynamicImage::from_decoder(decoder).map_err(damaged)?))
}

fn to_linear(decoded: DynamicImage) -> Image {
    let linear = matches!(decoded, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
    let pixels = decoded.to_rgb32f();
    let to_linear = |value: f32| if linear { value } else { srgb_to_linear(value) };
    let rgb = pixels.pixels().map(|pixel| pixel.0.map(to_linear)).collect();
    Image::new(pixels.width(), pixels.height(), rgb)
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
