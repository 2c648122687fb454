//! Environment maps of .hdr and .exr files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use qtracer::scene::{EnvironmentMap, Material};

/// Texels of maps that are compiled.
const MOST_COMPILED: u32 = 1 << 16;

fuzz_target!(init: qtracer_fuzz::prepare(), |bytes: &[u8]| {
    let map = match EnvironmentMap::from_bytes(bytes) {
        Ok(map) => map,
        Err(problem) => return assert!(!problem.is_empty()),
    };
    assert_eq!(map.texels().len(), map.width() as usize * map.height() as usize);
    if map.width() * map.height() > MOST_COMPILED {
        return;
    }
    let grey = Material::diffuse([0.5; 3]);
    match qtracer_fuzz::square().environment_map(map).material("grey", grey).build() {
        Ok(scene) => qtracer_fuzz::use_scene(&scene),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
