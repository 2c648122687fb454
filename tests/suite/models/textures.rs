//! Textures of glTF files: where they come from, which slot takes which channels, and what is done where they can't be had.

use super::builder::{F32, Gltf, Place, warns};
use crate::support::{ENGINES, Engine, Render, render, small};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use qtracer::Scene;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::{MaterialKind, Wrap};
use serde_json::{Value, json};

/// A PNG file of one row.
fn png(texels: &[[u8; 4]]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, texels.len() as u32, 1);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(texels.as_flattened()).unwrap();
    bytes
}

const RED: [u8; 4] = [255, 0, 0, 255];
const GREEN: [u8; 4] = [0, 255, 0, 255];

/// A square from −1 to 1 in front of a camera that sees just that, u to the right, v down.
fn square(material: Value) -> Gltf {
    let mut file = Gltf::new();
    let positions = file.positions(&[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]);
    let uvs: Vec<u8> =
        [0.0f32, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let uvs = file.accessor(F32, "VEC2", 4, &uvs);
    let indices = file.indices(&[[0, 1, 2], [0, 2, 3]]);
    let attributes = json!({ "POSITION": positions, "TEXCOORD_0": uvs });
    file.mesh(json!({ "attributes": attributes, "indices": indices, "material": 0 }));
    file.add("materials", material);
    file.stand(json!({ "mesh": 0 }));
    let lens = json!({ "yfov": 2.0 * 0.25f64.atan(), "znear": 0.1, "aspectRatio": 1 });
    let camera = file.add("cameras", json!({ "type": "perspective", "perspective": lens }));
    file.stand(json!({ "camera": camera, "translation": [0, 0, 4] }));
    file
}

/// Adds a texture of an image in a view of the buffer; its number.
fn texture(file: &mut Gltf, texels: &[[u8; 4]]) -> usize {
    let view = file.view(&png(texels));
    let image = file.add("images", json!({ "bufferView": view, "mimeType": "image/png" }));
    file.add("textures", json!({ "source": image }))
}

#[test]
fn emission_is_seen_where_texture_coordinates_put_it() {
    let glow = json!({ "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 0 },
        "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0 } });
    let mut file = square(glow);
    texture(&mut file, &[RED, RED, GREEN, GREEN]);
    // What lies beside the image is as its edge, not as the other end.
    file.add("samplers", json!({ "wrapS": 33071 }));
    file.json["textures"][0]["sampler"] = json!(0);
    for engine in ENGINES {
        let image = render(&file.scene(), engine, &small(8, 4, 1), 4).image;
        let at = |column: usize| image.rgb[2 * 8 + column];
        // Twice as wide as high: the square takes the middle four columns.
        let [left, right] = [at(2), at(5)];
        assert!(left[0] > 0.9 && left[1] < 0.1, "{engine:?}: {left:?}");
        assert!(right[1] > 0.9 && right[0] < 0.1, "{engine:?}: {right:?}");
    }
}

#[test]
fn wraps_are_those_of_the_sampler_and_color_maps_are_kept_with_their_factor() {
    let color = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "baseColorFactor": [0.5, 1, 1, 1] },
        "normalTexture": { "index": 0, "scale": 0.25 } });
    let mut file = square(color);
    texture(&mut file, &[RED, GREEN]);
    file.add("samplers", json!({ "wrapS": 33071, "wrapT": 33648 }));
    file.json["textures"][0]["sampler"] = json!(0);
    let scene = file.scene();
    let textures = scene.materials[0].textures;
    let slot = textures.color.unwrap();
    assert_eq!((slot.texture, slot.wrap_u, slot.wrap_v), (0, Wrap::Clamp, Wrap::Mirror));
    assert_eq!((textures.normal, textures.normal_scale), (Some(slot), 0.25));
    assert_eq!((scene.textures.len(), &scene.textures[0].rgba[..]), (1, [RED, GREEN].as_flattened()));
    assert_eq!(scene.materials[0].kind.color().x, 0.5);
    assert!(matches!(
        scene.materials[0].kind,
        MaterialKind::MetallicRoughness { metallic: 1.0, roughness: 1.0, .. }
    ));
}

#[test]
fn images_come_from_views_data_and_files_alike() {
    let color = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } });
    let bytes = png(&[RED, GREEN]);
    let place = Place::new();
    place.write("maps/a b.png", &bytes);
    let data = format!("data:image/png;base64,{}", STANDARD.encode(&bytes));
    for uri in [data.as_str(), "maps/a%20b.png"] {
        let mut file = square(color.clone());
        let image = file.add("images", json!({ "uri": uri }));
        file.add("textures", json!({ "source": image }));
        let scene = Scene::load(place.write("a.glb", file.glb())).unwrap();
        assert_eq!(&scene.textures[0].rgba[..], [RED, GREEN].as_flattened(), "{uri}");
    }
}

#[test]
fn textures_that_cannot_be_had_leave_the_factor_and_a_warning() {
    let color = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "baseColorFactor": [0.5, 0.5, 0.5, 1] } });
    for (image, words) in [
        (
            json!({ "uri": "nowhere.png" }),
            "material \"material 0\", images[0] file \"nowhere.png\" no such file",
        ),
        (json!({ "uri": "../outside.png" }), "images[0] file \"../outside.png\""),
        (json!({ "uri": "http://example.com/a.png" }), "reads nothing from networks"),
        (json!({ "uri": "data:image/png;base64,AAAA" }), "is neither PNG nor JPEG"),
        (json!({ "bufferView": 0 }), "is neither PNG nor JPEG"),
        (json!({}), "has neither a bufferView nor a uri"),
    ] {
        let mut file = square(color.clone());
        let image = file.add("images", image);
        file.add("textures", json!({ "source": image }));
        let scene = file.scene();
        assert!(!scene.materials[0].textures.any() && scene.textures.is_empty());
        assert!(
            warns(&scene, words) && warns(&scene, "its factor is taken alone"),
            "{:?}",
            scene.file_warnings
        );
    }
    // Cut short behind its header.
    let mut file = square(color.clone());
    let bytes = png(&[RED, GREEN]);
    let view = file.view(&bytes[..bytes.len() - 20]);
    file.add("images", json!({ "bufferView": view }));
    file.add("textures", json!({ "source": 0 }));
    assert!(warns(&file.scene(), "its factor is taken alone"));
    // A texture of an extension's own format has no source.
    let mut file = square(color);
    file.add("textures", json!({ "extensions": { "KHR_texture_basisu": { "source": 0 } } }));
    assert!(warns(&file.scene(), "is not there"));
}

#[test]
fn meshes_without_coordinates_wear_the_material_without_its_textures() {
    let mut file =
        square(json!({ "name": "wood", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    texture(&mut file, &[RED]);
    let positions = file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
    for _ in 0..2 {
        let bare = file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": 2, "material": 0 }));
        file.stand(json!({ "mesh": bare }));
    }
    let scene = file.scene();
    let names: Vec<&str> =
        scene.shapes.iter().map(|shape| scene.materials[shape.material].name.as_str()).collect();
    assert_eq!(names, ["wood", "wood (untextured)", "wood (untextured)"]);
    assert!(warns(
        &scene,
        "meshes[1], primitives[0] and 1 more: has a material with textures, but no TEXCOORD_0"
    ));
}

#[test]
fn a_material_of_the_files_own_is_not_taken_for_one_without_textures() {
    let mut file =
        square(json!({ "name": "wood", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    texture(&mut file, &[RED]);
    let own = json!({ "baseColorFactor": [1, 0, 0, 1] });
    file.add("materials", json!({ "name": "wood (untextured)", "pbrMetallicRoughness": own }));
    let positions = file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
    let bare = file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": 2, "material": 0 }));
    file.stand(json!({ "mesh": bare }));
    let scene = file.scene();
    let worn = &scene.materials[scene.shapes[1].material];
    assert_eq!((worn.name.as_str(), worn.kind.color()), ("wood (untextured) (2)", DVec3::ONE));
}

#[test]
fn a_file_placed_three_times_is_read_once_and_so_are_its_textures() {
    let mut file =
        square(json!({ "name": "wood", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    texture(&mut file, &[RED, GREEN]);
    let place = Place::new();
    place.write("square.glb", file.glb());
    let shape = |file: &str, more: &str| format!("[[shapes]]\ntype = 'mesh'\nfile = '{file}'\n{more}\n");
    let text = format!(
        "name = 'a'\n[camera]\norigin = [0, 0, 9]\ntarget = [0, 0, 0]\nfov_y_deg = 40\nwidth = 8\nheight = 8\n\
         [environment]\nradiance = [1, 1, 1]\n[materials.red]\ntype = 'diffuse'\ncolor = [1, 0, 0]\n{}{}{}{}",
        shape("square.glb", "material = 'red'"),
        shape("square.glb", "translate = [3, 0, 0]"),
        shape("./square.glb", "translate = [6, 0, 0]\nsmooth = false"),
        shape("square.glb", "translate = [9, 0, 0]")
    );
    let scene = Scene::load(place.write("scene.toml", text)).unwrap();
    let names: Vec<&str> = scene.materials.iter().map(|material| material.name.as_str()).collect();
    assert_eq!((names, scene.textures.len()), (vec!["red", "square.glb: wood"], 1));
    assert_eq!(scene.shapes.iter().map(|shape| shape.material).collect::<Vec<_>>(), [0, 1, 1, 1]);
    assert_eq!(scene.materials[1].textures.color.unwrap().texture, 0);
    // What is odd is told once for a file.
    let told = scene.file_warnings.iter().filter(|warning| warning.to_string().contains("its own"));
    assert_eq!(told.count(), 1, "{:?}", scene.file_warnings);
}

/// A PNG file that promises so many black texels and holds next to none.
fn promise(side: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side, side);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    writer.write_chunk(png::chunk::IDAT, &[0x78, 1]).unwrap();
    drop(writer);
    bytes
}

#[test]
fn texels_are_counted_before_images_are_decoded() {
    let with = |images: usize| {
        let mut file = square(json!({}));
        file.json["materials"] = json!([]);
        let view = file.view(&promise(8192));
        for number in 0..images {
            let image = file.add("images", json!({ "bufferView": view }));
            file.add("textures", json!({ "source": image }));
            file.add("materials", json!({ "normalTexture": { "index": number } }));
        }
        file
    };
    // 2²⁶ texels each: damaged, but not too many.
    assert!(warns(&with(4).scene(), "and 3 more: a texture that can't be had"));
    assert!(with(5).problem().contains("has textures of more than 268435456 texels (1 GiB) together"));
}

#[test]
fn only_textures_that_are_taken_are_counted() {
    let mut file = square(json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    texture(&mut file, &[RED]);
    texture(&mut file, &[GREEN]);
    // Of a material that nothing wears.
    file.add("materials", json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 1 } } }));
    let scene = file.scene();
    let taken = CompiledScene::new(&scene).surfaces.taken_images;
    assert_eq!((scene.textures.len(), taken), (2, 1));
}

/// A square under the sky whose roughness and metalness a texture of one texel multiplies.
fn rough_square(texel: Option<[u8; 4]>, metallic: f64, roughness: f64) -> Scene {
    let mut model = json!({ "metallicFactor": metallic, "roughnessFactor": roughness, "baseColorFactor": [0.9, 0.5, 0.1, 1] });
    if texel.is_some() {
        model["metallicRoughnessTexture"] = json!({ "index": 0 });
    }
    let mut file = square(json!({ "pbrMetallicRoughness": model }));
    if let Some(texel) = texel {
        texture(&mut file, &[texel]);
    }
    // A lamp beside the camera, whose highlight tells how rough the square is.
    file.light(json!({ "type": "point", "intensity": 30 }), json!({ "translation": [0.5, 0.5, 3] }));
    file.scene()
}

fn largest_difference(a: &Render, b: &Render) -> f32 {
    let pairs = a.image.rgb.as_flattened().iter().zip(b.image.rgb.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn green_multiplies_roughness_and_blue_metalness() {
    let options = small(6, 6, 2);
    let plain =
        |metallic, roughness| render(&rough_square(None, metallic, roughness), Engine::Cpu, &options, 16);
    // 51 is a fifth of 255.
    let (rough, metal) = (plain(0.0, 0.5), plain(1.0, 0.1));
    for engine in ENGINES {
        let textured = |texel| render(&rough_square(Some(texel), 1.0, 0.5), engine, &options, 16);
        let (as_rough, as_metal) = (textured([7, 255, 0, 255]), textured([7, 51, 255, 255]));
        assert!(largest_difference(&as_rough, &rough) < 1e-3, "{engine:?}");
        assert!(
            largest_difference(&as_metal, &metal) < 1e-2,
            "{engine:?}: {}",
            largest_difference(&as_metal, &metal)
        );
        // The comparison sees the difference.
        assert!(largest_difference(&as_metal, &rough) > 0.1 && largest_difference(&as_rough, &metal) > 0.1);
    }
}
