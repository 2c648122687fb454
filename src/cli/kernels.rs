//! `--dump-kernels`: the linked WGSL of a scene's kernels as files, to be read. No GPU takes part.

use super::failure::Failure;
use qtracer::engine::{preferred_engine, preferred_schedule};
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::link;
use qtracer::gpu::stage::Stage;
use qtracer::scene::compiled::CompiledScene;
use qtracer::{EngineChoice, EngineKind, RenderOptions, Scene};
use std::fs;
use std::path::Path;

/// Writes one file per stage of the engine asked for (the wavefront engine's where that has none); says what it wrote.
pub fn dump(folder: &Path, scene: &Scene, options: &RenderOptions) -> Result<String, Failure> {
    let compiled = CompiledScene::with_instances(scene, options.instances);
    let key = KernelKey::new(&compiled, &options.estimators(scene));
    let schedule = preferred_schedule(&key, options);
    let megakernel = options.engine == EngineChoice::Auto
        && preferred_engine(&compiled, &key, options) == EngineKind::Megakernel;
    let (stages, of) = match options.engine {
        EngineChoice::Megakernel => (Stage::megakernel(&key), "the megakernel engine"),
        EngineChoice::Auto if megakernel => (Stage::megakernel(&key), "the megakernel engine"),
        EngineChoice::Wavefront | EngineChoice::Auto => {
            (Stage::wavefront(&key, schedule), "the wavefront engine")
        }
        EngineChoice::Cpu => {
            (Stage::wavefront(&key, schedule), "the wavefront engine (the CPU engine has none)")
        }
    };
    let refuse = |path: &Path, error: std::io::Error| {
        let path = path.display();
        Failure::bad_input(format!("--dump-kernels: cannot write \"{path}\": {error}; choose another folder"))
    };
    fs::create_dir_all(folder).map_err(|e| refuse(folder, e))?;
    for &stage in &stages {
        let path = folder.join(format!("{}.wgsl", stage.name()));
        let text = link(stage, &key, schedule).map_err(Failure::failed)?;
        fs::write(&path, text).map_err(|e| refuse(&path, e))?;
    }
    let (count, folder) = (stages.len(), folder.display());
    Ok(format!("wrote {count} kernels of {of} to {folder}"))
}
