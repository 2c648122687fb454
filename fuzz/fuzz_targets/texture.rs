//! Textures of .png and .jpg files, in every slot of a material.
#![no_main]

use libfuzzer_sys::fuzz_target;
use qtracer::RenderOptions;
use qtracer::scene::{Material, MaterialTextures, Texture, TextureRef};

/// Texels of images that are rendered.
const MOST_RENDERED: u32 = 1 << 16;

fuzz_target!(init: qtracer_fuzz::prepare(), |bytes: &[u8]| {
    let texture = match Texture::from_bytes("texture", bytes) {
        Ok(texture) => texture,
        Err(problem) => return assert!(!problem.is_empty()),
    };
    assert_eq!(texture.rgba.len(), 4 * texture.width as usize * texture.height as usize);
    if texture.width * texture.height > MOST_RENDERED {
        return;
    }
    let slot = Some(TextureRef::new(0));
    let all = MaterialTextures {
        color: slot,
        metallic_roughness: slot,
        emission: slot,
        normal: slot,
        normal_scale: 1.0,
    };
    let material = Material::metallic_roughness([1.0; 3], 1.0, 1.0).emitting([1.0; 3]).textured(all);
    let scene = qtracer_fuzz::square().texture(texture).material("grey", material).build();
    qtracer_fuzz::render(&scene.expect("a texture that was read fits a scene"), RenderOptions::cpu());
});
