//! glTF's materials as qtracer's.

use super::builder::{Gltf, warns};
use glam::DVec3;
use qtracer::Scene;
use qtracer::scene::{Material, MaterialKind};
use serde_json::{Value, json};

/// A cube of that material.
fn with(material: Value) -> Gltf {
    let mut file = Gltf::cube();
    file.add("materials", material);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file.stand(json!({ "mesh": 0 }));
    file
}

fn material(given: Value) -> (Material, Scene) {
    let scene = with(given).scene();
    (scene.materials[0].clone(), scene)
}

#[test]
fn emission_is_the_factor_times_the_strength() {
    let strong = json!({ "emissiveFactor": [1.0, 0.5, 0.0], "extensions": {
        "KHR_materials_emissive_strength": { "emissiveStrength": 12.0 } } });
    let (found, scene) = material(strong);
    assert_eq!(found.emission, DVec3::new(12.0, 6.0, 0.0));
    assert_eq!(scene.environment, DVec3::ZERO, "it has light of its own");
    let (found, _) = material(json!({ "emissiveFactor": [1.0, 0.5, 0.0] }));
    assert_eq!(found.emission, DVec3::new(1.0, 0.5, 0.0));
    let (found, scene) = material(json!({ "emissiveFactor": [-1, 0, 0] }));
    assert!(found.emission == DVec3::ZERO && warns(&scene, "negative or infinite"));
}

#[test]
fn the_model_is_gltfs_own_with_its_usual_values() {
    let given = json!({ "pbrMetallicRoughness": {
        "baseColorFactor": [0.25, 0.5, 0.75, 0.1], "metallicFactor": 0.125, "roughnessFactor": 0.375 } });
    let color = DVec3::new(0.25, 0.5, 0.75);
    let expected = MaterialKind::MetallicRoughness { color, metallic: 0.125, roughness: 0.375 };
    assert_eq!(material(given).0.kind, expected);
    let usual = MaterialKind::MetallicRoughness { color: DVec3::ONE, metallic: 1.0, roughness: 1.0 };
    let mut none = Gltf::cube();
    none.stand(json!({ "mesh": 0 }));
    assert_eq!((material(json!({})).0.kind, none.scene().materials[0].kind), (usual, usual));
}

#[test]
fn transmission_makes_glass_of_the_index_given() {
    let glass = |factor: f64, ior: Value| {
        json!({ "pbrMetallicRoughness": { "baseColorFactor": [1, 0.5, 0.25, 1], "roughnessFactor": 0 }, "extensions": {
            "KHR_materials_transmission": { "transmissionFactor": factor }, "KHR_materials_ior": ior } })
    };
    let tint = DVec3::new(1.0, 0.5, 0.25);
    let kind = |given| material(given).0.kind;
    assert_eq!(kind(glass(1.0, json!({ "ior": 1.25 }))), MaterialKind::Dielectric { tint, ior: 1.25 });
    assert_eq!(kind(glass(1.0, json!({}))), MaterialKind::Dielectric { tint, ior: 1.5 });
    assert_eq!(kind(glass(1.0, json!({ "ior": 0 }))), MaterialKind::Dielectric { tint, ior: 10.0 });
    let mut rough = glass(1.0, json!({}));
    rough["pbrMetallicRoughness"]["roughnessFactor"] = json!(0.25);
    assert_eq!(kind(rough), MaterialKind::RoughDielectric { tint, ior: 1.5, roughness: 0.25 });
    assert!(!matches!(kind(glass(0.0, json!({}))), MaterialKind::Dielectric { .. }));
    let (half, scene) = material(glass(0.5, json!({})));
    assert!(
        matches!(half.kind, MaterialKind::Dielectric { .. })
            && warns(&scene, "lets a part of the light through")
    );
}

#[test]
fn what_has_no_counterpart_is_told_of() {
    for (given, words) in [
        (json!({ "alphaMode": "BLEND" }), "is see-through where its alpha is low"),
        (json!({ "alphaMode": "MASK" }), "is see-through where its alpha is low"),
        (json!({ "extensions": { "KHR_materials_unlit": {} } }), "is unlit, so it emits its color"),
        (json!({ "doubleSided": true, "emissiveFactor": [1, 1, 1] }), "shines on both sides in the file"),
        (
            json!({ "pbrMetallicRoughness": { "roughnessFactor": 7 } }),
            "has a factor that is not within 0 to 1",
        ),
    ] {
        let (_, scene) = material(given);
        assert!(warns(&scene, words), "{words}: {:?}", scene.file_warnings);
    }
    let (_, scene) = material(json!({ "doubleSided": true, "name": "cloth" }));
    assert_eq!(scene.file_warnings.len(), 2, "no camera, no light: {:?}", scene.file_warnings);
    assert_eq!(scene.materials[0].name, "cloth");
}

#[test]
fn names_that_are_the_same_are_told_apart() {
    let mut file = with(json!({ "name": "a" }));
    file.add("materials", json!({ "name": "a" }));
    file.add("materials", json!({}));
    let names: Vec<String> = file.scene().materials.iter().map(|material| material.name.clone()).collect();
    assert_eq!(names, ["a", "a (2)", "material 2"]);
}

#[test]
fn extensions_that_a_file_needs_are_refused_and_those_that_it_uses_told_of() {
    let mut file = with(json!({}));
    file.json["extensionsUsed"] = json!(["KHR_lights_punctual", "KHR_materials_clearcoat", "X_new"]);
    let scene = file.scene();
    assert!(warns(&scene, "\"KHR_materials_clearcoat\", \"X_new\": not read"), "{:?}", scene.file_warnings);
    file.json["extensionsRequired"] = json!(["KHR_mesh_quantization", "KHR_materials_ior"]);
    assert!(file.load().is_ok());
    file.json["extensionsRequired"] = json!(["KHR_materials_ior", "KHR_draco_mesh_compression"]);
    let problem = file.problem();
    assert!(
        problem.ends_with(
            "needs \"KHR_draco_mesh_compression\", which qtracer does not read; write the file without"
        ),
        "{problem}"
    );
}

#[test]
fn skins_morphs_and_animations_are_told_of() {
    let mut file = with(json!({}));
    let joint = file.stand(json!({}));
    let skin = file.add("skins", json!({ "joints": [joint] }));
    file.json["nodes"][0]["skin"] = json!(skin);
    file.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 0 }]);
    file.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(0);
    file.json["meshes"][0]["primitives"][0]["attributes"]["_OWN"] = json!(0);
    let sampler = json!({ "input": 0, "output": 0 });
    let channel = json!({ "sampler": 0, "target": { "node": 0, "path": "translation" } });
    file.add("animations", json!({ "samplers": [sampler], "channels": [channel] }));
    let scene = file.scene();
    for words in ["has a skin", "has morph targets", "1 animations: not played", "has colors at its corners"]
    {
        assert!(warns(&scene, words), "{words}: {:?}", scene.file_warnings);
    }
}
