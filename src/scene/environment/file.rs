//! Environment maps from files: Radiance HDR and OpenEXR. Files are data from anywhere: damaged, truncated or lying ones
//! are errors, never a panic, and nothing is allocated before the header's size is checked.

use std::io::Cursor;
use std::path::Path;

use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers};
use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;

use super::{EnvironmentMap, check_size};
use crate::scene::SceneError;
use crate::scene::error::quoted;
use crate::scene::files::{FileKind, plausible_image, within_folder};
use crate::untrusted::unless_it_panics;

/// 2²³ texels of 16 bytes, eight such layers.
const MAPS: FileKind =
    FileKind { most_bytes: 1 << 30, wanted: "a .hdr or .exr file", smaller: "scale the map down" };
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
const RADIANCE_MAGIC: &[u8] = b"#?";

impl EnvironmentMap {
    /// Reads a Radiance `.hdr` or an OpenEXR `.exr` file (its first layer with R, G and B) of linear radiance in latitude
    /// and longitude. The content decides, not the name. `EXPOSURE` and `COLORCORR` of Radiance files are not applied.
    ///
    /// # Errors
    /// Files that are missing, not regular, above 1 GiB, of another kind, truncated or malformed, and everything that
    /// [`new`](Self::new) refuses.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let path = path.as_ref();
        read(path).map_err(|problem| SceneError::File { path: path.to_owned(), problem })
    }

    /// Decodes such a file that lies in memory.
    ///
    /// # Errors
    /// What is of another kind, truncated or malformed, and everything that [`new`](Self::new) refuses; says what is wrong and
    /// the remedy.
    pub fn from_bytes(encoded: &[u8]) -> Result<Self, String> {
        decode(encoded)
    }
}

/// Reads the map that a scene names, which must lie within the scene's folder.
pub(in crate::scene) fn of_scene(name: &str, folder: Option<&Path>) -> Result<EnvironmentMap, String> {
    let map = format!("map {}", quoted(name));
    let path = within_folder(folder, name).map_err(|problem| format!("{map} {problem}"))?;
    read(&path).map_err(|problem| format!("{map} {problem}"))
}

fn read(path: &Path) -> Result<EnvironmentMap, String> {
    decode(&MAPS.bytes(path, u64::MAX)?)
}

/// A map out of the bytes of a file.
pub(super) fn decode(bytes: &[u8]) -> Result<EnvironmentMap, String> {
    unless_it_panics("is damaged; write it anew".to_owned(), || decode_kind(bytes))
}

fn decode_kind(bytes: &[u8]) -> Result<EnvironmentMap, String> {
    match bytes {
        _ if bytes.starts_with(&EXR_MAGIC) => decode_exr(bytes),
        _ if bytes.starts_with(RADIANCE_MAGIC) => decode_radiance(bytes),
        _ if image::guess_format(bytes).is_ok() => Err(
            "has a low dynamic range, in which no sun fits; convert it to linear radiance as .hdr or .exr"
                .to_owned(),
        ),
        _ => Err("is neither a Radiance .hdr nor an OpenEXR .exr file; convert it".to_owned()),
    }
}

fn damaged(error: impl std::fmt::Display) -> String {
    format!("is damaged ({error}); write it anew")
}

fn decode_radiance(bytes: &[u8]) -> Result<EnvironmentMap, String> {
    // Not strict, since "#?RGBE" is as common a first line as "#?RADIANCE".
    let decoder = HdrDecoder::new_nonstrict(Cursor::new(bytes)).map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into())?;
    plausible_image(bytes.len(), width, height, size_of::<[f32; 3]>() as u64)?;
    let mut texels = vec![[0f32; 3]; width as usize * height as usize];
    decoder.read_image(bytemuck::cast_slice_mut(&mut texels)).map_err(damaged)?;
    EnvironmentMap::checked(width, height, texels)
}

fn decode_exr(bytes: &[u8]) -> Result<EnvironmentMap, String> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(damaged)?;
    for header in &meta.headers {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        check_size(width as u64, height as u64)?;
        plausible_image(bytes.len(), width as u32, height as u32, size_of::<[f32; 3]>() as u64)?;
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgba_channels(
            |size, _| (size.width(), vec![[0f32; 3]; size.width() * size.height()]),
            |(width, texels), at, (r, g, b, _): (f32, f32, f32, f32)| {
                texels[at.y() * *width + at.x()] = [r, g, b];
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| format!("has no layer of R, G and B that can be read ({error}); write it anew"))?;
    let (width, texels) = image.layer_data.channel_data.pixels;
    EnvironmentMap::checked(width as u32, (texels.len() / width) as u32, texels)
}
