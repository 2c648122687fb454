//! Scene files: JSON where the text begins with a brace, else TOML.
#![no_main]

use libfuzzer_sys::fuzz_target;
use qtracer::Scene;

fuzz_target!(init: qtracer_fuzz::prepare(), |bytes: &[u8]| {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let scene = match text.trim_start().starts_with('{') {
        true => Scene::from_json(text),
        false => Scene::from_toml(text),
    };
    match scene {
        Ok(scene) => qtracer_fuzz::use_scene(&scene),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
