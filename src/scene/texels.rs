//! Looking textures up: four texels around a point, decoded, then blended. GPU twin: kernels/scene/texels.wesl

use super::compiled::{CompiledScene, Material, NONE};
use super::shading::mapped_normal;
use super::shapes::Surface;
use super::surfaces::{MaterialMaps, TextureImage};
use glam::{UVec4, Vec2, Vec3};

pub const WRAP_REPEAT: u32 = 0;
pub const WRAP_CLAMP: u32 = 1;
pub const WRAP_MIRROR: u32 = 2;
/// Where the word of a texture says how it goes on sideways, and up and down; its number lies below.
pub const WRAP_U_SHIFT: u32 = 24;
pub const WRAP_V_SHIFT: u32 = 26;

/// The coordinate within the first image, or the first two of a mirrored one, so that it counts few texels.
#[inline]
fn within(u: f32, wrap: u32) -> f32 {
    if wrap == WRAP_CLAMP {
        return u.clamp(0.0, 1.0);
    }
    let period = if wrap == WRAP_MIRROR { 2.0 } else { 1.0 };
    u - period * (u / period).floor()
}

/// The texel that stands at place `i`, at least −1, of a side of `size`.
#[inline]
fn wrapped(i: i32, size: i32, wrap: u32) -> i32 {
    if wrap == WRAP_CLAMP {
        return i.clamp(0, size - 1);
    }
    let period = if wrap == WRAP_MIRROR { 2 * size } else { size };
    let place = (i + period) % period;
    place.min(2 * size - 1 - place)
}

/// Texels around a point: upper left, upper right, lower left, lower right; and how much the right and the lower count.
struct Texels {
    words: UVec4,
    share: Vec2,
}

#[inline]
fn texel(scene: &CompiledScene, image: &TextureImage, column: i32, row: i32) -> u32 {
    let i = row as u32 * image.width + column as u32;
    scene.surfaces.texels[(image.first_row + i / 4) as usize][(i % 4) as usize]
}

#[inline]
fn texels_around(scene: &CompiledScene, texture: u32, uv: Vec2) -> Texels {
    let image = &scene.surfaces.images[(texture & ((1 << WRAP_U_SHIFT) - 1)) as usize];
    let (wrap_u, wrap_v) = (texture >> WRAP_U_SHIFT & 3, texture >> WRAP_V_SHIFT & 3);
    let (width, height) = (image.width as i32, image.height as i32);
    let x = within(uv.x, wrap_u) * image.width as f32 - 0.5;
    let y = within(uv.y, wrap_v) * image.height as f32 - 0.5;
    let (column, row) = (x.floor(), y.floor());
    let (left, right) = (wrapped(column as i32, width, wrap_u), wrapped(column as i32 + 1, width, wrap_u));
    let (upper, lower) = (wrapped(row as i32, height, wrap_v), wrapped(row as i32 + 1, height, wrap_v));
    let words = UVec4::new(
        texel(scene, image, left, upper),
        texel(scene, image, right, upper),
        texel(scene, image, left, lower),
        texel(scene, image, right, lower),
    );
    Texels { words, share: Vec2::new(x - column, y - row) }
}

#[inline]
fn blended(share: Vec2, a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> Vec3 {
    let upper = a * (1.0 - share.x) + b * share.x;
    let lower = c * (1.0 - share.x) + d * share.x;
    upper * (1.0 - share.y) + lower * share.y
}

#[inline]
fn srgb_value(scene: &CompiledScene, byte: u32) -> f32 {
    f32::from_bits(scene.surfaces.srgb[(byte / 4) as usize][(byte % 4) as usize])
}

/// The linear colour that a texel's first three bytes mean as sRGB.
#[inline]
fn srgb_color(scene: &CompiledScene, word: u32) -> Vec3 {
    Vec3::new(
        srgb_value(scene, word & 255),
        srgb_value(scene, word >> 8 & 255),
        srgb_value(scene, word >> 16 & 255),
    )
}

/// A texel's first three bytes as numbers.
#[inline]
fn bytes_of(word: u32) -> Vec3 {
    Vec3::new((word & 255) as f32, (word >> 8 & 255) as f32, (word >> 16 & 255) as f32)
}

/// The linear colour of an sRGB texture.
#[inline]
pub fn texture_color(scene: &CompiledScene, texture: u32, uv: Vec2) -> Vec3 {
    let Texels { words, share } = texels_around(scene, texture, uv);
    let [a, b, c, d] = words.to_array().map(|word| srgb_color(scene, word));
    blended(share, a, b, c, d)
}

/// Three numbers, 0 to 255, of a linear texture.
#[inline]
pub fn texture_bytes(scene: &CompiledScene, texture: u32, uv: Vec2) -> Vec3 {
    let Texels { words, share } = texels_around(scene, texture, uv);
    let [a, b, c, d] = words.to_array().map(bytes_of);
    blended(share, a, b, c, d)
}

/// The material as its textures make it there, and the surface with the normal of its normal map.
#[inline]
pub fn textured(scene: &CompiledScene, material: u32, surface: &mut Surface) -> Material {
    let maps = &scene.surfaces.maps[material as usize];
    surface.shading_normal = mapped_normal(scene, surface, maps);
    textured_material(scene, &scene.materials[material as usize], maps, surface.uv)
}

/// The material as its textures make it there.
#[inline]
pub fn textured_material(
    scene: &CompiledScene,
    material: &Material,
    maps: &MaterialMaps,
    uv: Vec2,
) -> Material {
    let mut there = *material;
    if maps.color != NONE {
        there.color *= texture_color(scene, maps.color, uv);
    }
    if maps.metallic_roughness != NONE {
        let bytes = texture_bytes(scene, maps.metallic_roughness, uv);
        there.roughness *= bytes.y / 255.0;
        there.metallic *= bytes.z / 255.0;
    }
    if maps.emission != NONE {
        there.emission *= texture_color(scene, maps.emission, uv);
    }
    there
}

/// What a lamp of that material emits there.
#[inline]
pub fn textured_emission(scene: &CompiledScene, material: u32, uv: Vec2) -> Vec3 {
    let emission = scene.materials[material as usize].emission;
    let texture = scene.surfaces.maps[material as usize].emission;
    if texture == NONE { emission } else { emission * texture_color(scene, texture, uv) }
}
