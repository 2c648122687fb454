//! Images of textures: in views of buffers, `data:` URIs, or files in the folder of the .gltf file or below.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use ::gltf::json::texture::{Texture as Given, WrappingMode};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Root};

use super::accessor::view_bytes;
use super::buffers::{Buffers, from_uri};
use crate::scene::model::findings::Findings;
use crate::scene::texture::{TEXTURES, check_total, texels_promised};
use crate::scene::{Texture, TextureRef, Wrap};

/// The images of a file, each decoded once, when a material asks for it.
pub(super) struct Images<'a> {
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    folder: Option<&'a Path>,
    /// Numbers of textures by those of images; nothing for those that can't be had.
    known: BTreeMap<usize, Option<usize>>,
    /// Of all images that were met, also of those whose decoding failed.
    texels: u64,
    pub all: Vec<Texture>,
}

impl<'a> Images<'a> {
    pub fn new(root: &'a Root, buffers: &'a Buffers<'a>, folder: Option<&'a Path>) -> Self {
        Images { root, buffers, folder, known: BTreeMap::new(), texels: 0, all: Vec::new() }
    }

    /// What a material's slot refers to, if it can be had; `set` is that of the texture coordinates. `Err` says why there are too
    /// many.
    pub fn texture(
        &mut self,
        index: Index<Given>,
        set: u32,
        place: &str,
        findings: &mut Findings,
    ) -> Result<Option<TextureRef>, String> {
        if set != 0 {
            findings.note(
                "has a texture by TEXCOORD_1 or above, which is not read; its factor is taken alone",
                place,
            );
            return Ok(None);
        }
        let given = &self.root.textures[index.value()];
        let Some(texture) = self.image(given.source.value(), place, findings)? else { return Ok(None) };
        let sampler = given.sampler.and_then(|sampler| self.root.samplers.get(sampler.value()));
        let wrap = |mode: Option<Checked<WrappingMode>>| match mode {
            Some(Checked::Valid(WrappingMode::ClampToEdge)) => Wrap::Clamp,
            Some(Checked::Valid(WrappingMode::MirroredRepeat)) => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        let [wrap_u, wrap_v] = [sampler.map(|s| s.wrap_s), sampler.map(|s| s.wrap_t)].map(wrap);
        Ok(Some(TextureRef { texture, wrap_u, wrap_v }))
    }

    /// The number of the texture of that image, decoded if it is new.
    fn image(&mut self, image: usize, place: &str, findings: &mut Findings) -> Result<Option<usize>, String> {
        if let Some(&known) = self.known.get(&image) {
            return Ok(known);
        }
        let bytes = self.bytes(image);
        self.texels += bytes.as_ref().map_or(0, |bytes| texels_promised(bytes));
        check_total(self.texels)?;
        let decoded = match bytes.and_then(|bytes| Texture::from_bytes(self.name(image), &bytes)) {
            Ok(texture) => Some(texture),
            Err(problem) => {
                let what = "a texture that can't be had; its factor is taken alone";
                findings.note(what, format_args!("{place}, images[{image}] {problem}"));
                None
            }
        };
        let number = decoded.is_some().then_some(self.all.len());
        self.all.extend(decoded);
        self.known.insert(image, number);
        Ok(number)
    }

    /// The image's file.
    fn bytes(&self, image: usize) -> Result<Cow<'a, [u8]>, String> {
        let given = self.root.images.get(image).ok_or("is not there")?;
        match (given.buffer_view, &given.uri) {
            (Some(view), _) => Ok(Cow::Borrowed(view_bytes(self.root, self.buffers, view)?)),
            (None, Some(uri)) => Ok(Cow::Owned(from_uri(uri, &TEXTURES, u64::MAX, self.folder)?)),
            (None, None) => Err("has neither a bufferView nor a uri".to_owned()),
        }
    }

    fn name(&self, image: usize) -> String {
        self.root.images[image].name.clone().unwrap_or_else(|| format!("images[{image}]"))
    }
}
