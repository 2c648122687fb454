//! Links the kernel modules of one stage into one WGSL text: imports, `@if` flags and stripping of what is unreachable,
//! by `wesl`, which is met in this file only.

use super::key::KernelKey;
use super::stage::{Schedule, Stage};
use crate::film::BlockSum;
use crate::guiding::{GuideUniforms, Trail, Transition};
use crate::layout::GpuStruct;
use crate::scene::compiled::{Light, Material, Quad, Sphere, Triangle, Uniforms};
use crate::scene::environment::{SkyCell, SkyRow};
use crate::scene::instance::Instance;
use crate::scene::light_tree::LightCluster;
use crate::scene::surfaces::{MaterialMaps, TextureImage, TriangleNormals, TriangleUvs};
use crate::transport::items::{HitItem, RayItem, ShadowItem};
use std::borrow::Cow;
use wesl::{CompileOptions, Feature, Features, ManglerKind, ModulePath, VirtualResolver, Wesl};

macro_rules! modules {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_str!(concat!("../../kernels/", $path, ".wesl")))),*]
    };
}

/// Every kernel module, by its path under kernels/.
pub const MODULES: &[(&str, &str)] = modules![
    "base/random",
    "base/sampling",
    "base/vector",
    "scene/bvh",
    "scene/camera",
    "scene/data",
    "scene/instance",
    "scene/shading",
    "scene/shapes",
    "scene/texels",
    "scene/sky",
    "scene/triangle",
    "scene/two_levels",
    "bsdf/dielectric",
    "bsdf/diffuse",
    "bsdf/ggx",
    "bsdf/glossy",
    "bsdf/interface",
    "bsdf/metal",
    "bsdf/metallic_roughness",
    "bsdf/mirror",
    "bsdf/rough_dielectric",
    "guiding/commit",
    "guiding/data",
    "guiding/lessons",
    "guiding/octant",
    "guiding/quadtree",
    "guiding/table",
    "transport/guide",
    "transport/light",
    "transport/light_tree",
    "transport/path",
    "transport/roulette",
    "transport/split",
    "transport/step",
    "stages/arguments",
    "stages/commit",
    "stages/compact",
    "stages/environment",
    "stages/follow",
    "stages/generate",
    "stages/intersect",
    "stages/learn",
    "stages/megakernel",
    "stages/prepare_rays",
    "stages/prepare_shade",
    "stages/queues",
    "stages/resolve",
    "stages/shade",
    "stages/shadow",
    "stages/sorted",
    "stages/step",
];

/// The kernel sources are part of the program, so this is a bug in qtracer, never in a scene.
#[derive(Clone, Debug, thiserror::Error)]
#[error("kernel {kernel} does not link: {reason}")]
pub struct LinkError {
    pub kernel: String,
    pub reason: String,
}

/// Structs shared with the host, generated from their Rust declarations.
fn item_declarations() -> String {
    [
        Uniforms::wgsl(),
        Sphere::wgsl(),
        Sphere::wgsl_rows(),
        Quad::wgsl(),
        Quad::wgsl_rows(),
        Triangle::wgsl(),
        Triangle::wgsl_rows(),
        Instance::wgsl(),
        Instance::wgsl_rows(),
        Material::wgsl(),
        Material::wgsl_rows(),
        Light::wgsl(),
        Light::wgsl_rows(),
        TriangleNormals::wgsl(),
        TriangleNormals::wgsl_rows(),
        TriangleUvs::wgsl(),
        TriangleUvs::wgsl_rows(),
        MaterialMaps::wgsl(),
        MaterialMaps::wgsl_rows(),
        TextureImage::wgsl(),
        TextureImage::wgsl_rows(),
        SkyRow::wgsl(),
        SkyRow::wgsl_rows(),
        SkyCell::wgsl(),
        SkyCell::wgsl_rows(),
        LightCluster::wgsl(),
        LightCluster::wgsl_rows(),
        RayItem::wgsl(),
        RayItem::wgsl_rows(),
        HitItem::wgsl(),
        ShadowItem::wgsl(),
        ShadowItem::wgsl_rows(),
        BlockSum::wgsl(),
        GuideUniforms::wgsl(),
        Trail::wgsl(),
        Trail::wgsl_rows(),
        Transition::wgsl(),
        Transition::wgsl_rows(),
    ]
    .join("\n")
}

/// The WGSL of one stage for scenes with this key.
pub fn link(stage: Stage, key: &KernelKey, schedule: Schedule) -> Result<String, LinkError> {
    link_modules(MODULES, stage, key, schedule)
}

/// [`link`] from other sources than [`MODULES`]: tests break them on purpose. A flag that no one set is an error, so a
/// misspelt one is found.
pub fn link_modules(
    modules: &[(&str, &str)],
    stage: Stage,
    key: &KernelKey,
    schedule: Schedule,
) -> Result<String, LinkError> {
    let error = |reason: String| LinkError { kernel: stage.name(), reason };
    let path = |name: &str| -> Result<ModulePath, LinkError> {
        let path = format!("package::{}", name.replace('/', "::"));
        path.parse().map_err(|e| error(format!("{path}: {e:?}")))
    };
    let mut sources = VirtualResolver::new();
    for (name, text) in modules {
        sources.add_module(path(name)?, Cow::Borrowed(*text));
    }
    sources.add_module(path("items")?, item_declarations().into());
    sources.add_module(path("key")?, stage.constants(key).into());
    let flags = stage.key(*key).flags().into_iter().chain(stage.flags(key, schedule));
    let features = Features {
        default: Feature::Error,
        flags: flags.map(|(name, on)| (name.to_string(), on.into())).collect(),
    };
    let mut compiler = Wesl::new_barebones().set_custom_resolver(sources);
    compiler.set_options(CompileOptions { features, validate: false, ..Default::default() });
    // Names are unique across modules (naga would refuse a second declaration), so the text keeps them readable.
    compiler.set_mangler(ManglerKind::None);
    let root = path(&format!("stages/{}", stage.module()))?;
    let linked = compiler.compile(&root).map_err(|e| error(e.to_string()))?;
    Ok(format!("// qtracer kernel {} for {key}\n{linked}", stage.name()))
}
