//! Models of .gltf and .glb files, by their first bytes.
#![no_main]

use libfuzzer_sys::fuzz_target;
use qtracer::Scene;

fuzz_target!(init: qtracer_fuzz::prepare(), |bytes: &[u8]| {
    match Scene::from_gltf("model", bytes) {
        Ok(scene) => qtracer_fuzz::use_scene(&scene),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
