//! Textures from PNG and JPEG, by `image`.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{ImageFormat, ImageReader};

use super::{LONGEST_SIDE, MOST_TEXELS, Texture, check_sum};
use crate::scene::SceneError;
use crate::scene::error::quoted;
use crate::scene::files::{FileKind, io_problem, plausible_image, within_folder};
use crate::untrusted::unless_it_panics;

pub(in crate::scene) const TEXTURES: FileKind =
    FileKind { most_bytes: 256 << 20, wanted: "a .png or .jpg file", smaller: "reduce the image" };

impl Texture {
    /// Reads a `.png`, `.jpg` or `.jpeg` file. Grey becomes RGB, 16 bits become 8.
    ///
    /// # Errors
    /// Files that are missing, not regular, above 256 MiB, of another extension, damaged, or of more than 16384 texels a
    /// side or 2²⁶ in all, which is checked before anything is decoded.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        read(path, name).map_err(|problem| SceneError::File { path: path.to_owned(), problem })
    }

    /// Decodes a PNG or JPEG file that lies in memory.
    ///
    /// # Errors
    /// What is neither or damaged, and sizes as for [`load`](Self::load); says what is wrong and the remedy.
    pub fn from_bytes(name: impl Into<String>, encoded: &[u8]) -> Result<Self, String> {
        decode(encoded, name.into())
    }
}

/// The textures that a scene file names, each file read once.
pub(in crate::scene) struct TextureFiles<'a> {
    folder: Option<&'a Path>,
    numbers: BTreeMap<PathBuf, usize>,
    pub all: Vec<Texture>,
}

impl<'a> TextureFiles<'a> {
    pub fn new(folder: Option<&'a Path>) -> Self {
        Self { folder, numbers: BTreeMap::new(), all: Vec::new() }
    }

    /// The number of the texture in that file, which must lie within the scene's folder. `Err` says what is wrong.
    pub fn number(&mut self, name: &str) -> Result<usize, String> {
        let file = format!("file {}", quoted(name));
        let path = within_folder(self.folder, name).map_err(|problem| format!("{file} {problem}"))?;
        if let Some(&number) = self.numbers.get(&path) {
            return Ok(number);
        }
        let texture = read(&path, name.to_owned()).map_err(|problem| format!("{file} {problem}"))?;
        self.all.push(texture);
        check_sum(&self.all)?;
        self.numbers.insert(path, self.all.len() - 1);
        Ok(self.all.len() - 1)
    }
}

fn read(path: &Path, name: String) -> Result<Texture, String> {
    TEXTURES.length(path)?;
    match path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase().as_str() {
        "png" | "jpg" | "jpeg" => {}
        "" => return Err("has no extension; textures end in .png or .jpg".to_owned()),
        other => return Err(format!("has the extension {}; textures end in .png or .jpg", quoted(other))),
    }
    decode(&TEXTURES.bytes(path, u64::MAX)?, name)
}

fn decode(encoded: &[u8], name: String) -> Result<Texture, String> {
    unless_it_panics(DAMAGED.to_owned(), || decode_small(encoded, name))
}

const DAMAGED: &str = "is damaged; write it anew as PNG or JPEG";

/// Texels that the header of an image promises; 0 where it has none, or more than an image may have.
pub(in crate::scene) fn texels_promised(encoded: &[u8]) -> u64 {
    let size = || {
        let source = ImageReader::new(Cursor::new(encoded)).with_guessed_format().ok();
        let is_known =
            |source: &ImageReader<_>| matches!(source.format(), Some(ImageFormat::Png | ImageFormat::Jpeg));
        Ok(source.filter(is_known).and_then(|source| source.into_dimensions().ok()))
    };
    match unless_it_panics((), size) {
        Ok(Some((width, height))) if check_size(width, height).is_ok() => {
            u64::from(width) * u64::from(height)
        }
        _ => 0,
    }
}

/// Decodes what is small enough by its header.
fn decode_small(encoded: &[u8], name: String) -> Result<Texture, String> {
    let source = ImageReader::new(Cursor::new(encoded));
    let mut reader = source.with_guessed_format().map_err(|error| io_problem(&error))?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err("is neither PNG nor JPEG; convert it".to_owned());
    }
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(LONGEST_SIDE);
    limits.max_image_height = Some(LONGEST_SIDE);
    // 16-bit RGBA, and as much again for what the decoder needs.
    limits.max_alloc = Some(2 * 8 * MOST_TEXELS);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|error| damaged(&error))?;
    let (width, height) = image::ImageDecoder::dimensions(&decoder);
    check_size(width, height)?;
    plausible_image(encoded.len(), width, height, 4)?;
    let decoded = image::DynamicImage::from_decoder(decoder).map_err(|error| damaged(&error))?;
    Ok(Texture::new(name, width, height, decoded.into_rgba8().into_raw()))
}

/// The rules for the size of a texture.
pub(in crate::scene) fn check_size(width: u32, height: u32) -> Result<(), String> {
    let problem = match (width.min(height), width.max(height)) {
        (0, _) => "has no texels; give it 1 at least",
        (_, longest) if longest > LONGEST_SIDE => "has a side above 16384; reduce the image",
        _ if u64::from(width) * u64::from(height) > MOST_TEXELS => {
            "has more than 2^26 texels; reduce the image"
        }
        _ => return Ok(()),
    };
    Err(format!("is {width} x {height}: {problem}"))
}

fn damaged(error: &image::ImageError) -> String {
    match error {
        image::ImageError::Limits(_) => {
            "is too large to decode; reduce it to 16384 texels a side and 2^26 in all".to_owned()
        }
        error => {
            let words: String = error.to_string().chars().take(120).collect();
            format!("can't be decoded ({words}); write it anew as PNG or JPEG")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_promise_texels_and_damage_promises_none() {
        let mut bytes = Vec::new();
        let mut writer = png::Encoder::new(&mut bytes, 5, 3).write_header().unwrap();
        writer.write_chunk(png::chunk::IDAT, &[0x78, 1]).unwrap();
        drop(writer);
        assert_eq!(texels_promised(&bytes), 15);
        assert_eq!((texels_promised(&bytes[..20]), texels_promised(b"neither")), (0, 0));
    }
}
