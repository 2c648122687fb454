//! PNG: 8 bits of sRGB for looking at. No tone mapping: exposure, then clamped.

use std::io::Write;

use super::srgb::linear_to_srgb8;
use super::write::EncodeError;
use super::{Image, Metadata};

impl From<png::EncodingError> for EncodeError {
    fn from(error: png::EncodingError) -> Self {
        match error {
            png::EncodingError::IoError(error) => EncodeError::Io(error),
            other => EncodeError::Format(other.to_string()),
        }
    }
}

pub(super) fn encode(out: &mut impl Write, image: &Image, exposure: f32) -> Result<(), EncodeError> {
    let gain = exposure.exp2();
    let bytes: Vec<u8> = image.rgb.iter().flatten().map(|&value| linear_to_srgb8(value * gain)).collect();
    let mut encoder = png::Encoder::new(out, image.width, image.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    add_texts(&mut encoder, &image.metadata)?;
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&bytes)?;
    Ok(writer.finish()?)
}

/// tEXt holds Latin-1 only; what is not ASCII goes to iTXt, which is UTF-8.
fn add_texts<W: Write>(encoder: &mut png::Encoder<W>, metadata: &Metadata) -> Result<(), EncodeError> {
    for (key, value) in metadata.iter() {
        let (key, value) = (key.to_string(), value.to_string());
        if value.is_ascii() {
            encoder.add_text_chunk(key, value)?;
        } else {
            encoder.add_itxt_chunk(key, value)?;
        }
    }
    Ok(())
}
