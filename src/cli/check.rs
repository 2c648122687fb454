//! `check`: is this a scene, and what is in it?

use super::console;
use super::failure::Failure;
use clap::Args;
use qtracer::engine::{InstanceStats, SurfaceStats};
use qtracer::gpu::key::{KIND_NAMES, KernelKey};
use qtracer::scene::MaterialKind;
use qtracer::scene::compiled::CompiledScene;
use qtracer::scene::environment::Sky;
use qtracer::{RenderOptions, Scene};
use std::path::{Path, PathBuf};

#[derive(Args)]
#[command(after_help = "\
Examples:
  qtracer check scenes/cornell-box.toml
      What is in it, or what is wrong with it and where.
  qtracer check scenes/*.toml > /dev/null && echo all good
      Exits 2 if any scene is bad; every problem is named on stderr.
  qtracer check room.json model.glb
      JSON has the same keys as TOML; a model is a scene by itself.")]
pub struct CheckArgs {
    /// Scene files (.toml or .json) or models (.glb, .gltf, .ply or .obj)
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
}

pub fn run(args: &CheckArgs) -> Result<(), Failure> {
    let mut bad = 0;
    for path in &args.scenes {
        match Scene::load(path) {
            Ok(scene) => {
                console::data(describe(path, &scene))?;
                let file = path.display();
                let tell = |warning| console::warning(format!("{file}: {warning}"));
                scene.warnings().iter().for_each(tell);
            }
            Err(error) => {
                console::error(error);
                bad += 1;
            }
        }
    }
    match (bad, args.scenes.len()) {
        (0, _) => Ok(()),
        (bad, all) => Err(Failure::bad_input(format!("{bad} of {all} scenes can't be used"))),
    }
}

fn describe(path: &Path, scene: &Scene) -> String {
    let compiled = CompiledScene::new(scene);
    let defaults = &scene.defaults;
    let key = KernelKey::new(&compiled, &RenderOptions::default().estimators(scene));
    let on_off = |on| if on { "on" } else { "off" };
    let environment = match scene.environment.max_element() > 0.0 {
        true => " and the environment",
        false => "",
    };
    let mut lines = vec![
        format!("{}", path.display()),
        format!("  name       {}", scene.name),
        format!("  size       {}x{}", scene.camera.width, scene.camera.height),
        format!(
            "  render     {} samples/pixel, {} levels, direct light {}, roulette {}",
            defaults.spp,
            defaults.max_bounces,
            on_off(defaults.direct_light),
            on_off(defaults.roulette)
        ),
        format!("  shapes     {}: {}", scene.shapes.len(), shapes(scene, &compiled)),
        format!("  materials  {}: {}", scene.materials.len(), kinds(scene)),
        format!("  lights     {}{environment}", compiled.lights.len()),
    ];
    lines.extend(compiled.sky.as_ref().map(|sky| environment_map(sky, &compiled)));
    lines.push(format!("  kernels    {key}"));
    lines.extend(InstanceStats::new(&compiled).map(|stats| instances(&stats)));
    lines.extend(SurfaceStats::new(&compiled).map(|stats| surfaces(&stats)));
    lines.join("\n")
}

/// `  surfaces   64.0 KiB of normals, 128.0 KiB of texture coordinates, 1 texture of 6.8 KiB`.
fn surfaces(stats: &SurfaceStats) -> String {
    let SurfaceStats { normal_bytes, uv_bytes, textures, texture_bytes } = *stats;
    let kib = |bytes: usize| bytes as f64 / 1024.0;
    format!(
        "  surfaces   {:.1} KiB of normals, {:.1} KiB of texture coordinates, {textures} {} of {:.1} KiB",
        kib(normal_bytes),
        kib(uv_bytes),
        if textures == 1 { "texture" } else { "textures" },
        kib(texture_bytes)
    )
}

/// `  instances  1000 of 1 mesh: 100000 triangles seen as 100000000, in 11.1 MiB, not 10681.2 MiB`.
fn instances(stats: &InstanceStats) -> String {
    let InstanceStats { instances, meshes, stored_triangles, seen_triangles, bytes, laid_out_bytes } = *stats;
    let mib = |bytes: u64| bytes as f64 / f64::powi(2.0, 20);
    format!(
        "  instances  {instances} of {meshes} {}: {stored_triangles} triangles seen as {seen_triangles}, in {:.1} MiB, not {:.1} MiB",
        if meshes == 1 { "mesh" } else { "meshes" },
        mib(bytes),
        mib(laid_out_bytes)
    )
}

/// What was made of the environment map.
fn environment_map(sky: &Sky, compiled: &CompiledScene) -> String {
    let why = match compiled.lights.len() {
        0 => "all shadow rays: there is no lamp",
        _ => "shadow rays, by its power against that of the lamps",
    };
    let (share, kilobytes) = (100.0 * sky.share, sky.bytes().div_ceil(1 << 10));
    format!("  map        {}x{}, {kilobytes} KiB, gets {share:.0} % of {why}", sky.width, sky.height)
}

/// `1 sphere, 12 quads`, and `2 meshes of 96 triangles` where there are any.
fn shapes(scene: &Scene, compiled: &CompiledScene) -> String {
    let counted =
        |count: usize, one: &str, many: &str| format!("{count} {}", if count == 1 { one } else { many });
    let plain = [
        counted(compiled.spheres.len(), "sphere", "spheres"),
        counted(compiled.quads.len(), "quad", "quads"),
    ]
    .join(", ");
    let triangles = counted(compiled.triangle_count(), "triangle", "triangles");
    match scene.shapes.iter().filter(|shape| shape.geometry.mesh().is_some()).count() {
        0 => plain,
        meshes => format!("{plain}, {} of {triangles}", counted(meshes, "mesh", "meshes")),
    }
}

/// `3 diffuse, 1 mirror`.
fn kinds(scene: &Scene) -> String {
    let number = |kind: &MaterialKind| match kind {
        MaterialKind::Diffuse { .. } => 0,
        MaterialKind::Mirror { .. } => 1,
        MaterialKind::Glossy { .. } => 2,
        MaterialKind::Dielectric { .. } => 3,
        MaterialKind::Metal { .. } => 4,
        MaterialKind::MetallicRoughness { .. } => 5,
        MaterialKind::RoughDielectric { .. } => 6,
    };
    let mut counts = [0; KIND_NAMES.len()];
    scene.materials.iter().for_each(|m| counts[number(&m.kind)] += 1);
    let present = counts.iter().zip(KIND_NAMES).filter(|(count, _)| **count > 0);
    let words: Vec<String> =
        present.map(|(count, name)| format!("{count} {}", name.replace('_', "-"))).collect();
    words.join(", ")
}
