//! Meshes of .ply files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use qtracer::scene::{MeshData, MeshFormat};

fuzz_target!(init: qtracer_fuzz::prepare(), |bytes: &[u8]| {
    match MeshData::from_bytes(MeshFormat::Ply, bytes) {
        Ok(data) => qtracer_fuzz::use_mesh(data),
        Err(problem) => assert!(!problem.is_empty()),
    }
});
