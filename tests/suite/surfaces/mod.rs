//! What surfaces have besides where they are: smooth normals, texture coordinates, textures, normal maps; by the kernels
//! themselves and by their twins, against f64 and against laws of light.

mod energy;
mod errors;
pub mod images;
mod normals;
mod texels;

use crate::support::icosphere;
use glam::DVec3;
use qtracer::scene::{Material, MaterialTextures, MeshData, Scene, SceneBuilder, Texture, TextureRef};

/// Twenty times four to that power triangles, with the normals of the sphere that they stand for.
fn smooth_sphere(levels: u32) -> MeshData {
    let data = icosphere(levels);
    MeshData { normals: data.positions.clone(), ..data }
}

/// A scene that no one looks at, to add things to.
fn unseen() -> SceneBuilder {
    Scene::builder("surfaces").camera([0.0, 0.0, 9.0], [0.0; 3], 40.0)
}

/// An image of these texels, alpha added.
fn image(width: u32, texels: &[[u8; 3]]) -> Texture {
    let rgba: Vec<u8> = texels.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect();
    Texture::new("an image", width, texels.len() as u32 / width, rgba)
}

fn color_texture(texture: usize) -> MaterialTextures {
    MaterialTextures { color: Some(TextureRef::new(texture)), ..Default::default() }
}

/// The square from −1 to 1 in x and y, facing z, as two triangles; its coordinates are those of an image that lies on it
/// upright.
fn square() -> MeshData {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    MeshData {
        positions: corners.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec(),
        uvs: corners.map(|[x, y]| [(x as f32 + 1.0) / 2.0, (1.0 - y as f32) / 2.0]).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    }
}

fn white() -> Material {
    Material::diffuse([1.0; 3])
}
