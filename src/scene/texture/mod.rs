//! Images on surfaces: as given ([`Texture`]), and which of them a material takes for what ([`MaterialTextures`]).

mod file;

use std::sync::Arc;

use super::texels::WRAP_U_SHIFT;

pub(super) use file::{TEXTURES, TextureFiles, check_size, texels_promised};

/// Texels along a side at most.
pub(super) const LONGEST_SIDE: u32 = 16_384;
/// Texels of an image at most: 256 MiB.
pub(super) const MOST_TEXELS: u64 = 1 << 26;
/// Texels that a scene may have in all: 1 GiB.
const MOST_IN_ALL: u64 = 1 << 28;
/// Textures that a scene may have: so many have a number below the bits that say how they go on beyond their edges.
const MOST_TEXTURES: usize = 1 << WRAP_U_SHIFT;

/// An image for surfaces; cheap to clone. What takes it says how its numbers are meant: colours are sRGB, everything else is
/// linear.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// For messages.
    pub name: String,
    /// Columns, 1 to 16384.
    pub width: u32,
    /// Rows, 1 to 16384; 2²⁶ texels at most.
    pub height: u32,
    /// Red, green, blue and alpha of each texel, row by row from the top. Alpha is not used.
    pub rgba: Arc<[u8]>,
}

impl Texture {
    /// An image of that size. Nothing is checked before a scene takes it in.
    pub fn new(name: impl Into<String>, width: u32, height: u32, rgba: impl Into<Arc<[u8]>>) -> Self {
        Self { name: name.into(), width, height, rgba: rgba.into() }
    }
}

/// Whether all textures of a scene together are few and small enough.
pub(super) fn check_sum(textures: &[Texture]) -> Result<(), String> {
    check_count(textures.len())?;
    check_total(textures.iter().map(|texture| u64::from(texture.width) * u64::from(texture.height)).sum())
}

/// Whether a scene may have so many textures.
fn check_count(textures: usize) -> Result<(), String> {
    match textures <= MOST_TEXTURES {
        true => Ok(()),
        false => Err(format!("has {textures} textures; stay within {MOST_TEXTURES}")),
    }
}

/// Whether a scene may have so many texels in all.
pub(super) fn check_total(texels: u64) -> Result<(), String> {
    match texels <= MOST_IN_ALL {
        true => Ok(()),
        false => Err(format!("has textures of more than {MOST_IN_ALL} texels (1 GiB) together; reduce them")),
    }
}

/// Which textures a material takes. Each multiplies what the material says by itself, but for the normal map.
///
/// Texture coordinates are glTF's: (0, 0) is the upper left corner of the image, v goes down. Look-ups blend four texels,
/// decoded first, so colours mix as light does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialTextures {
    /// Colour or tint, sRGB.
    pub color: Option<TextureRef>,
    /// Roughness by green and metallic by blue, linear, as in glTF.
    pub metallic_roughness: Option<TextureRef>,
    /// Emission, sRGB.
    pub emission: Option<TextureRef>,
    /// Normals in tangent space, linear: red along u, green up the image, blue outwards. 128 means 0, so that a map which
    /// is flat bends nothing; glTF means 127.5, which no byte is.
    pub normal: Option<TextureRef>,
    /// Factor on red and green of the normal map. 1 unless said.
    pub normal_scale: f64,
}

impl Default for MaterialTextures {
    /// None.
    fn default() -> Self {
        Self { color: None, metallic_roughness: None, emission: None, normal: None, normal_scale: 1.0 }
    }
}

impl MaterialTextures {
    /// Adds to the number of each texture, where those of a file come behind others.
    pub(super) fn move_by(&mut self, first: usize) {
        let slots = [&mut self.color, &mut self.metallic_roughness, &mut self.emission, &mut self.normal];
        slots.into_iter().flatten().for_each(|slot| slot.texture += first);
    }

    /// Those that there are, by the keys of scene files.
    pub(super) fn each(&self) -> impl Iterator<Item = (&'static str, TextureRef)> {
        [
            ("color_texture", self.color),
            ("metallic_roughness_texture", self.metallic_roughness),
            ("emission_texture", self.emission),
            ("normal_texture", self.normal),
        ]
        .into_iter()
        .filter_map(|(key, texture)| Some((key, texture?)))
    }

    /// Whether there are any.
    pub fn any(&self) -> bool {
        self.each().next().is_some()
    }
}

/// A texture and how it goes on beyond its edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TextureRef {
    /// Index into [`Scene::textures`](super::Scene::textures).
    pub texture: usize,
    /// To the left and right.
    pub wrap_u: Wrap,
    /// Above and below.
    pub wrap_v: Wrap,
}

impl TextureRef {
    /// The texture of that number, repeated.
    pub fn new(texture: usize) -> Self {
        Self { texture, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat }
    }
}

/// What lies beyond the edges of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The image again.
    #[default]
    Repeat,
    /// The texels at the edge.
    Clamp,
    /// The image again, every other time mirrored.
    Mirror,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_have_a_limit_of_texels_and_of_textures() {
        let texels: Arc<[u8]> = Arc::new([0; 4]);
        let of = |count: usize, side: u32| vec![Texture::new("", side, side, texels.clone()); count];
        assert_eq!(check_sum(&of(4, 8192)), Ok(()));
        assert!(check_sum(&of(5, 8192)).unwrap_err().contains("more than 268435456 texels"));
        assert_eq!(check_sum(&of(1000, 1)), Ok(()));
        assert_eq!(check_count(MOST_TEXTURES), Ok(()));
        assert!(check_count(MOST_TEXTURES + 1).unwrap_err().contains("stay within 16777216"));
    }
}
