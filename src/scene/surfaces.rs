//! What surfaces have besides where they are, as the kernels read it: normals and texture coordinates at the corners of
//! triangles, and textures. Every part is empty where nothing in the scene needs it.

use super::Wrap;
use super::compiled::NONE;
use super::rows::Row;
use super::shading::packed_normal;
use super::texels::{WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT, WRAP_U_SHIFT, WRAP_V_SHIFT};
use super::texture::{MaterialTextures, Texture, TextureRef};
use super::{Material, Mesh, Scene};
use crate::gpu_struct;
use glam::{DVec3, Vec3};
use std::collections::HashMap;

gpu_struct! {
    /// Normals at the corners of a triangle, on its outer side, in two 16-bit numbers each.
    pub struct TriangleNormals {
        a: u32,
        b: u32,
        c: u32,
        /// 0 if it has none: a flat triangle in a scene where others are smooth.
        given: u32,
    }
    /// Texture coordinates at the corners of a triangle.
    pub struct TriangleUvs {
        u_a: f32,
        v_a: f32,
        u_b: f32,
        v_b: f32,
        u_c: f32,
        v_c: f32,
        _pad0: u32,
        _pad1: u32,
    }
    /// The textures of a material, NONE where it has none: the number of an image, and in the upper bits how it goes on
    /// beyond its edges.
    pub struct MaterialMaps {
        color: u32,
        metallic_roughness: u32,
        emission: u32,
        normal: u32,
        /// Factor on what the normal map says along the surface.
        normal_scale: f32,
        _pad0: u32,
        _pad1: u32,
        _pad2: u32,
    }
    /// An image: four texels to a row, from this row of all texels on.
    pub struct TextureImage {
        first_row: u32,
        width: u32,
        height: u32,
        _pad0: u32,
    }
}

impl TriangleUvs {
    pub(super) fn new([[u_a, v_a], [u_b, v_b], [u_c, v_c]]: [[f32; 2]; 3]) -> TriangleUvs {
        TriangleUvs { u_a, v_a, u_b, v_b, u_c, v_c, ..Default::default() }
    }
}

/// All of it.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    /// One for each triangle, if any mesh has normals.
    pub normals: Vec<TriangleNormals>,
    /// One for each triangle, if any mesh is textured.
    pub uvs: Vec<TriangleUvs>,
    /// One for each material, if any that a shape has is textured; so with what follows.
    pub maps: Vec<MaterialMaps>,
    pub images: Vec<TextureImage>,
    /// How many of these have texels: those that a material of a shape takes.
    pub taken_images: usize,
    /// Four texels to a row, red in the lowest byte.
    pub texels: Vec<Row>,
    /// What each byte of an sRGB colour means, four to a row.
    pub srgb: Vec<Row>,
    /// Whether any normal map is used,
    pub normal_maps: bool,
    /// … and whether anything that emits has a texture for that.
    pub textured_lamps: bool,
    /// What an emission texture leaves of the emission of each material on average; empty without.
    mean_emission: Vec<Vec3>,
    smooth: bool,
}

impl Surfaces {
    /// The textures of the scene; what triangles have is added mesh by mesh.
    pub fn new(scene: &Scene) -> Surfaces {
        let mut used = vec![false; scene.materials.len()];
        scene.shapes.iter().for_each(|shape| used[shape.material] = true);
        let smooth =
            scene.shapes.iter().filter_map(|shape| shape.geometry.mesh()).any(|mesh| mesh.is_smooth());
        let textured = |(material, used): &(&Material, &bool)| **used && material.textures.any();
        let mut surfaces = Surfaces { smooth, ..Default::default() };
        let materials = || scene.materials.iter().zip(&used);
        if !materials().any(|pair| textured(&pair)) {
            return surfaces;
        }
        let taken: Vec<MaterialTextures> = materials()
            .map(|pair| if textured(&pair) { pair.0.textures } else { MaterialTextures::default() })
            .collect();
        surfaces.maps = taken.iter().map(compile_maps).collect();
        surfaces.add_images(&scene.textures, &taken);
        surfaces.srgb = srgb_rows();
        surfaces.normal_maps = taken.iter().any(|textures| textures.normal.is_some());
        surfaces.textured_lamps = taken.iter().any(|textures| textures.emission.is_some());
        if surfaces.textured_lamps {
            let means = means(&scene.textures, taken.iter().filter_map(|textures| textures.emission));
            let mean = |texture: TextureRef| means[&texture.texture];
            surfaces.mean_emission =
                taken.iter().map(|textures| textures.emission.map_or(Vec3::ONE, mean)).collect();
        }
        surfaces
    }

    /// Whether shading normals may differ from those of the shapes.
    pub fn bends_normals(&self) -> bool {
        self.smooth || self.normal_maps
    }

    pub fn is_textured(&self) -> bool {
        !self.maps.is_empty()
    }

    /// Whether triangles have normals or texture coordinates.
    pub fn changes_triangles(&self) -> bool {
        self.smooth || self.is_textured()
    }

    /// Whether any mesh has normals.
    pub fn is_smooth(&self) -> bool {
        self.smooth
    }

    /// Adds what the triangles of a mesh have, in their order.
    pub fn add_mesh(&mut self, mesh: &Mesh) {
        self.add(mesh.len(), mesh.normals(), mesh.uvs().map(TriangleUvs::new));
    }

    /// Adds what so many triangles have: one of each for each, or none.
    pub(super) fn add(
        &mut self,
        triangles: usize,
        normals: impl Iterator<Item = [Vec3; 3]>,
        uvs: impl Iterator<Item = TriangleUvs>,
    ) {
        if self.smooth {
            let before = self.normals.len();
            self.normals.extend(normals.map(|corners| {
                let [a, b, c] = corners.map(packed_normal);
                TriangleNormals { a, b, c, given: 1 }
            }));
            self.normals.resize(before + triangles, TriangleNormals::default());
        }
        if self.is_textured() {
            let before = self.uvs.len();
            self.uvs.extend(uvs);
            self.uvs.resize(before + triangles, TriangleUvs::default());
        }
    }

    /// What a lamp of that material emits on average, as a share of what the material says.
    pub fn mean_emission(&self, material: u32) -> Vec3 {
        self.mean_emission.get(material as usize).copied().unwrap_or(Vec3::ONE)
    }

    /// Everything that a picture depends on.
    pub fn bytes(&self) -> [&[u8]; 5] {
        use bytemuck::cast_slice as bytes;
        let Surfaces { normals, uvs, maps, images, texels, .. } = self;
        [bytes(normals), bytes(uvs), bytes(maps), bytes(images), bytes(texels)]
    }

    /// The images that materials take; of the others nothing is kept but their number.
    fn add_images(&mut self, textures: &[Texture], taken: &[MaterialTextures]) {
        let mut wanted = vec![false; textures.len()];
        taken.iter().flat_map(MaterialTextures::each).for_each(|(_, texture)| wanted[texture.texture] = true);
        for (texture, wanted) in textures.iter().zip(wanted) {
            let first_row = self.texels.len() as u32;
            self.images.push(TextureImage {
                first_row,
                width: texture.width,
                height: texture.height,
                ..Default::default()
            });
            if wanted {
                self.taken_images += 1;
                let (whole, rest) = texture.rgba.as_chunks::<16>();
                let mut last = [0; 16];
                last[..rest.len()].copy_from_slice(rest);
                let last = (!rest.is_empty()).then_some(&last);
                self.texels.extend(whole.iter().chain(last).map(texel_row));
            }
        }
    }
}

fn texel_row(bytes: &[u8; 16]) -> Row {
    std::array::from_fn(|i| u32::from_le_bytes(std::array::from_fn(|k| bytes[4 * i + k])))
}

fn compile_maps(textures: &MaterialTextures) -> MaterialMaps {
    let word = |texture: Option<TextureRef>| texture.map_or(NONE, texture_word);
    MaterialMaps {
        color: word(textures.color),
        metallic_roughness: word(textures.metallic_roughness),
        emission: word(textures.emission),
        normal: word(textures.normal),
        normal_scale: textures.normal_scale as f32,
        ..Default::default()
    }
}

fn texture_word(texture: TextureRef) -> u32 {
    let wrap = |wrap| match wrap {
        Wrap::Repeat => WRAP_REPEAT,
        Wrap::Clamp => WRAP_CLAMP,
        Wrap::Mirror => WRAP_MIRROR,
    };
    texture.texture as u32 | wrap(texture.wrap_u) << WRAP_U_SHIFT | wrap(texture.wrap_v) << WRAP_V_SHIFT
}

/// Linear value of a byte of an sRGB colour (IEC 61966-2-1).
fn srgb_value(byte: u8) -> f64 {
    let display = f64::from(byte) / 255.0;
    if display <= 0.04045 { display / 12.92 } else { ((display + 0.055) / 1.055).powf(2.4) }
}

fn srgb_rows() -> Vec<Row> {
    let value = |byte: usize| (srgb_value(byte as u8) as f32).to_bits();
    (0..64).map(|row| std::array::from_fn(|i| value(4 * row + i))).collect()
}

/// Means of these textures by their numbers; of one that many materials have only once.
fn means(textures: &[Texture], taken: impl Iterator<Item = TextureRef>) -> HashMap<usize, Vec3> {
    let mut means = HashMap::new();
    for TextureRef { texture, .. } in taken {
        means.entry(texture).or_insert_with(|| mean_color(&textures[texture]).as_vec3());
    }
    means
}

/// Mean over the texels, in linear light.
fn mean_color(texture: &Texture) -> DVec3 {
    let mut counts = [[0u64; 256]; 3];
    for texel in texture.rgba.as_chunks::<4>().0 {
        (0..3).for_each(|channel| counts[channel][usize::from(texel[channel])] += 1);
    }
    let texels = (texture.rgba.len() / 4) as f64;
    DVec3::from_array(counts.map(|counts| {
        let sum: f64 = (0..256).map(|byte| counts[byte] as f64 * srgb_value(byte as u8)).sum();
        sum / texels
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_a_texture_that_many_materials_have_is_taken_once() {
        let grey = |byte: u8| Texture::new("", 1, 1, vec![byte; 4]);
        let taken = (0..1000).map(|number| TextureRef::new(number % 2));
        let means = means(&[grey(0), grey(255), grey(9)], taken);
        assert_eq!((means.len(), means[&0], means[&1]), (2, Vec3::ZERO, Vec3::ONE));
    }
}
