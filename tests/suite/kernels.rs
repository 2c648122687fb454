//! The kernels as text: they link for every key, are valid, have the layouts that Rust has, and hold only what is needed.

use crate::support::{
    Engine, SCHEDULES, SPLITTING_SCHEDULES, estimators, icosphere, render, root, scene, scene_names, small,
};
use crate::surfaces::images::everything;
use naga::TypeInner;
use qtracer::film::BlockSum;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::{MODULES, link};
use qtracer::gpu::stage::{GRID_WIDTH, MEGAKERNEL_WORKGROUP, Schedule, Stage, WORKGROUP};
use qtracer::guiding::{
    GuideMode, GuideUniforms, Trail, Transition, commit, lessons, quadtree, state, table,
};
use qtracer::layout::GpuStruct;
use qtracer::random::{DIMENSION_CAMERA, dimension_bsdf, dimension_guide, dimension_light};
use qtracer::scene::compiled::{self, CompiledScene, Light, Material, Quad, Sphere, Triangle, Uniforms};
use qtracer::scene::rows;
use qtracer::scene::shapes::{RELATIVE_OFFSET, T_MISS};
use qtracer::scene::surfaces::{MaterialMaps, TextureImage, TriangleNormals, TriangleUvs};
use qtracer::scene::triangle::SMALLEST_SQUARE;
use qtracer::scene::{Geometry, Material as SceneMaterial, MaterialTextures, MeshData};
use qtracer::scene::{shading, texels};
use qtracer::transport::estimators::Estimators;
use qtracer::transport::guide::{LEAST_RADIANCE, LEAST_SEEN, MOST_PROPOSED};
use qtracer::transport::items::{HitItem, RayItem, ShadowItem};
use qtracer::transport::path::SHADOW_END;
use qtracer::transport::roulette::{LEAST_SURVIVAL, ROULETTE_FROM_BOUNCE, Roulette};
use qtracer::transport::split::{BUDGET_SHIFT, MAX_SPLIT, SEED_SHIFT};
use qtracer::{Sampler, Scene};
use std::collections::{BTreeMap, BTreeSet};

fn validate(wgsl: &str) -> naga::Module {
    let module =
        naga::front::wgsl::parse_str(wgsl).unwrap_or_else(|e| panic!("{}\n{wgsl}", e.emit_to_string(wgsl)));
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{}\n{wgsl}", e.emit_to_string(wgsl)));
    module
}

fn all_stages(key: &KernelKey) -> Vec<(Stage, Schedule)> {
    let mut stages: Vec<_> = Stage::megakernel(key).into_iter().map(|s| (s, Schedule::Fused)).collect();
    let splits = key.places > 1;
    for schedule in SCHEDULES.into_iter().filter(|schedule| !splits || SPLITTING_SCHEDULES.contains(schedule))
    {
        stages.extend(Stage::wavefront(key, schedule).into_iter().map(|s| (s, schedule)));
    }
    stages
}

/// Direct light, roulette by throughput, independent samples, no guide.
fn usual() -> Estimators {
    Estimators { sampler: Sampler::Independent, ..estimators(GuideMode::Off, Roulette::Throughput) }
}

/// Guides and roulettes of which something is learnt.
const LEARNING: [(GuideMode, Roulette); 7] = [
    (GuideMode::Off, Roulette::Learnt),
    (GuideMode::Adaptive, Roulette::Throughput),
    (GuideMode::Adaptive, Roulette::Learnt),
    (GuideMode::Octant, Roulette::Off),
    (GuideMode::Octant, Roulette::Learnt),
    (GuideMode::Bansal, Roulette::Throughput),
    (GuideMode::BansalReweighted, Roulette::Learnt),
];

fn learning((guide, roulette): (GuideMode, Roulette)) -> Estimators {
    Estimators { guide, roulette, ..usual() }
}

/// The guide with the most text and learnt roulette, which makes up to so many copies of a path.
fn splitting(split: u32) -> Estimators {
    Estimators { split, ..learning(LEARNING[2]) }
}

/// All linked kernels of a scene, by name and schedule.
fn linked(scene: &Scene, estimators: &Estimators) -> Vec<(String, String)> {
    let key = KernelKey::new(&CompiledScene::new(scene), estimators);
    let text = |(stage, schedule): (Stage, Schedule)| {
        (format!("{} ({schedule:?})", stage.name()), link(stage, &key, schedule).unwrap())
    };
    all_stages(&key).into_iter().map(text).collect()
}

/// A ball under the sky, of the given material.
fn ball(material: SceneMaterial) -> Scene {
    Scene::builder("ball")
        .camera([0.0, 0.0, 4.0], [0.0; 3], 45.0)
        .environment([1.0; 3])
        .material("ball", material)
        .sphere([0.0; 3], 1.0, "ball")
        .build()
        .unwrap()
}

/// Each material kind, with the prefix of its functions in the kernels.
fn kinds() -> [(&'static str, SceneMaterial); 7] {
    [
        ("diffuse_", SceneMaterial::diffuse([0.5; 3])),
        ("mirror_", SceneMaterial::mirror([0.5; 3], 0.5)),
        ("glossy_", SceneMaterial::glossy([0.5; 3], 10.0)),
        ("dielectric_", SceneMaterial::dielectric([1.0; 3], 1.5)),
        ("metal_", SceneMaterial::metal([0.5; 3], 0.5)),
        ("metallic_roughness_", SceneMaterial::metallic_roughness([0.5; 3], 0.5, 0.5)),
        ("rough_dielectric_", SceneMaterial::rough_dielectric([1.0; 3], 1.5, 0.5)),
    ]
}

/// Names of all functions and bindings of a kernel.
fn names(wgsl: &str) -> BTreeSet<String> {
    let module = validate(wgsl);
    let functions = module.functions.iter().filter_map(|(_, f)| f.name.clone());
    let globals = module.global_variables.iter().filter_map(|(_, g)| g.name.clone());
    functions.chain(globals).collect()
}

/// Triangles with or without spheres and quads beside them, each kind shining or not.
fn mesh_scenes() -> Vec<Scene> {
    let scene = |beside: usize, lamp: usize| {
        let mut builder = Scene::builder("meshes")
            .camera([0.0, 0.0, 4.0], [0.0; 3], 45.0)
            .material("dull", SceneMaterial::diffuse([0.5; 3]))
            .material("lamp", SceneMaterial::diffuse([0.0; 3]).emitting([1.0; 3]));
        let material = |kind| if kind == lamp { "lamp" } else { "dull" };
        builder = builder.mesh(icosphere(0), material(0));
        if beside & 1 != 0 {
            builder = builder.sphere([3.0, 0.0, 0.0], 1.0, material(1));
        }
        if beside & 2 != 0 {
            builder = builder.quad([0.0, 3.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], material(2));
        }
        builder.build().unwrap()
    };
    (0..4).flat_map(|beside| (0..4).map(move |lamp| scene(beside, lamp))).collect()
}

#[test]
fn every_stage_links_and_validates_for_every_scene_with_meshes() {
    let mut flags = BTreeSet::new();
    for scene in mesh_scenes() {
        for estimators in [usual(), learning(LEARNING[2])] {
            let key = KernelKey::new(&CompiledScene::new(&scene), &estimators);
            flags.extend(key.flags().into_iter().filter_map(|(name, on)| on.then_some(name)));
            for (stage, schedule) in all_stages(&key) {
                validate(&link(stage, &key, schedule).unwrap());
            }
        }
    }
    let lights = ["triangles", "triangle_lights", "sphere_lights", "quad_lights"];
    assert!(lights.iter().all(|flag| flags.contains(flag)), "{flags:?}");
}

/// What kernels hold where there is an environment map, and where direct light asks it or lamps.
#[test]
fn without_a_map_nothing_of_it_is_linked() {
    let all = |scene: &Scene, estimators: &Estimators| -> BTreeSet<String> {
        linked(scene, estimators).iter().flat_map(|(_, wgsl)| names(wgsl)).collect()
    };
    let map = ["sky_at", "sky_patch", "unpack_radiance", "angle_of"];
    let sampled = ["sample_sky", "choose_patch", "sky_light", "sample_linear", "sky_row_at"];
    let lamps = ["choose_light", "sample_light", "pdf_light", "light_at"];
    for name in ["cornell-box", "furnace-open-half", "mesh"] {
        let names = all(&scene(name), &usual());
        assert!(map.iter().chain(&sampled).all(|foreign| !names.contains(*foreign)), "{name}: {names:?}");
    }
    // Negative controls: with a map it is there, what chooses directions only with direct light, and lamps only where there
    // are some.
    let (open, interior) = (all(&scene("open-sky"), &usual()), all(&scene("interior"), &usual()));
    for names in [&open, &interior] {
        assert!(map.iter().chain(&sampled).all(|own| names.contains(*own)), "{names:?}");
    }
    assert!(lamps.iter().all(|lamp| open.contains(*lamp) && !interior.contains(*lamp)), "{interior:?}");
    let by_chance = all(&scene("open-sky"), &Estimators { direct_light: false, ..usual() });
    assert!(map.iter().all(|own| by_chance.contains(*own)), "{by_chance:?}");
    assert!(sampled.iter().chain(&lamps).all(|own| !by_chance.contains(*own)), "{by_chance:?}");
}

/// What kernels hold where there are triangles, and where these shine.
#[test]
fn without_meshes_nothing_of_triangles_is_linked() {
    let triangle = ["triangle_at", "triangle_distance", "intersect_triangle", "ray_shear", "onto_triangle"];
    let shining = ["sample_triangle", "sample_triangle_light"];
    let all = |scene: &Scene| -> BTreeSet<String> {
        linked(scene, &usual()).iter().flat_map(|(_, wgsl)| names(wgsl)).collect()
    };
    for name in ["cornell-box", "bansal-room-1", "many-lights"] {
        let names = all(&scene(name));
        let foreign: Vec<_> =
            names.iter().filter(|name| name.contains("triangle") || *name == "ray_shear").collect();
        assert!(foreign.is_empty(), "{name} holds {foreign:?}");
        for (kernel, wgsl) in linked(&scene(name), &usual()) {
            let module = validate(&wgsl);
            assert!(
                module.types.iter().all(|(_, ty)| ty.name.as_deref() != Some("Triangle")),
                "{kernel} of {name}"
            );
        }
    }
    // Negative control: with a mesh they are there, and light sampling only where it shines.
    let dark = all(&scene("mesh"));
    assert!(triangle.iter().all(|name| dark.contains(*name)), "{dark:?}");
    assert!(shining.iter().all(|name| !dark.contains(*name)), "{dark:?}");
    let bright = all(&mesh_scenes()[0]);
    assert!(triangle.iter().chain(&shining).all(|name| bright.contains(*name)), "{bright:?}");
    assert!(!bright.contains("sphere_at") && !bright.contains("quad_at"), "{bright:?}");
}

/// Names of what smooth normals, textures, normal maps and textured lamps need.
const OF_SURFACES: [(&str, &[&str]); 4] = [
    ("smooth_normals", &["triangle_normals_at", "unpacked_normal", "smooth_normal"]),
    ("textures", &["triangle_uvs_at", "texels_around", "texel_word", "srgb_value", "textured_material"]),
    ("normal_maps", &["mapped_normal", "triangle_tangents", "texture_bytes"]),
    ("textured_lamps", &["uv_at", "textured_emission"]),
];

/// Each where its flag is, and nowhere else; whatever is on, stages link and are valid.
#[test]
fn surfaces_link_what_they_have_and_nothing_else() {
    let everything = everything();
    let without = |change: &dyn Fn(&mut Scene)| {
        let mut scene = everything.clone();
        change(&mut scene);
        scene
    };
    let textures = |change: fn(&mut MaterialTextures)| {
        without(&|scene| scene.materials.iter_mut().for_each(|material| change(&mut material.textures)))
    };
    let scenes = [
        scene("mesh"),
        scene("cornell-box"),
        scene("surfaces"),
        textures(|textures| *textures = MaterialTextures::default()),
        textures(|textures| textures.normal = None),
        textures(|textures| textures.emission = None),
        textures(|textures| *textures = MaterialTextures { normal: textures.normal, ..Default::default() }),
        everything.clone(),
    ];
    let mut met = BTreeSet::new();
    for scene in &scenes {
        for estimators in [usual(), learning(LEARNING[2])] {
            let key = KernelKey::new(&CompiledScene::new(scene), &estimators);
            let kernels = linked(scene, &estimators);
            let all: BTreeSet<String> = kernels.iter().flat_map(|(_, wgsl)| names(wgsl)).collect();
            for (flag, functions) in OF_SURFACES {
                let on = key.flags().contains(&(flag, true));
                met.insert((flag, on));
                for name in functions {
                    assert_eq!(all.contains(*name), on, "{name} of {flag} in {}", scene.name);
                }
            }
        }
    }
    assert_eq!(met.len(), 2 * OF_SURFACES.len(), "each flag is on somewhere and off somewhere: {met:?}");
}

/// Rows: 1 of normals and 2 of coordinates for each triangle, if any has them; 2 for each material; for each image 1 and its
/// texels, 4 to a row; 64 to decode colours.
#[test]
fn rows_of_surfaces_are_as_many_as_they_have() {
    let count = |scene: &Scene| qtracer::scene::rows::pack(&CompiledScene::new(scene)).len();
    let scene = scene("surfaces");
    let (triangles, materials) = (4096, scene.materials.len());
    let plain = without_surfaces(&scene);
    let texels = (48 * 36) / 4;
    assert_eq!(count(&scene) - count(&plain), 3 * triangles + 2 * materials + 1 + texels + 64);
}

/// The scene without textures, its meshes flat.
fn without_surfaces(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    scene.materials.iter_mut().for_each(|material| material.textures = MaterialTextures::default());
    for shape in &mut scene.shapes {
        if let Geometry::Mesh(mesh) = &shape.geometry {
            let positions: Vec<_> = mesh.triangles().flatten().map(|p| p.as_dvec3()).collect();
            let triangles = (0..mesh.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
            let data = MeshData { positions, triangles, ..Default::default() };
            let flat = Scene::builder("flat").camera([0.0, 0.0, 1.0], [0.0; 3], 40.0);
            let flat = flat.material("m", SceneMaterial::diffuse([0.5; 3])).mesh(data, "m").build().unwrap();
            shape.geometry = flat.shapes[0].geometry.clone();
        }
    }
    scene
}

#[test]
fn every_stage_links_and_validates_for_every_kind_of_scene() {
    for name in [
        "cornell-box",
        "bansal-room-1",
        "furnace-open",
        "glass-caustic",
        "glossy-box",
        "metal-spheres",
        "rough-glass",
    ] {
        let compiled = CompiledScene::new(&scene(name));
        for direct_light in [false, true] {
            let unguided = [Roulette::Off, Roulette::Throughput].map(|roulette| (GuideMode::Off, roulette));
            for (guide, roulette) in unguided.into_iter().chain(LEARNING) {
                for sampler in [Sampler::Independent, Sampler::Stratified] {
                    let estimators = Estimators { direct_light, sampler, ..estimators(guide, roulette) };
                    // Guides meet shapes, materials and skies of every kind in these.
                    let few =
                        matches!(name, "bansal-room-1" | "furnace-open") && sampler == Sampler::Independent;
                    if estimators.learns() && !few {
                        continue;
                    }
                    let splits = if roulette == Roulette::Learnt && few { 1..3 } else { 1..2 };
                    for split in splits {
                        let key = KernelKey::new(&compiled, &Estimators { split, ..estimators });
                        // What only asks is what teaches, less some lines: enough to try it where paths split.
                        let keys = if split > 1 { vec![key, key.frozen()] } else { vec![key] };
                        for key in keys {
                            for (stage, schedule) in all_stages(&key) {
                                validate(&link(stage, &key, schedule).unwrap());
                            }
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn every_kernel_module_of_the_folder_is_linked_into_the_program() {
    let mut on_disk = BTreeSet::new();
    for folder in std::fs::read_dir(root().join("kernels")).unwrap().map(|e| e.unwrap().path()) {
        for file in std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()) {
            let stem = |path: &std::path::Path| path.file_stem().unwrap().to_string_lossy().into_owned();
            on_disk.insert(format!("{}/{}", stem(&folder), stem(&file)));
        }
    }
    let embedded: BTreeSet<String> = MODULES.iter().map(|(name, _)| name.to_string()).collect();
    assert_eq!(embedded, on_disk);
}

/// Name, (field, offset)…, size.
type Layout = (&'static str, Vec<(&'static str, usize)>, usize);

/// The shared structs as Rust has them.
fn rust_layouts() -> Vec<Layout> {
    fn layout<T: GpuStruct>() -> Layout {
        (T::NAME, T::FIELDS.iter().map(|f| (f.name, f.offset)).collect(), size_of::<T>())
    }
    vec![
        layout::<Uniforms>(),
        layout::<Sphere>(),
        layout::<Quad>(),
        layout::<Triangle>(),
        layout::<Material>(),
        layout::<Light>(),
        layout::<TriangleNormals>(),
        layout::<TriangleUvs>(),
        layout::<MaterialMaps>(),
        layout::<TextureImage>(),
        layout::<RayItem>(),
        layout::<HitItem>(),
        layout::<ShadowItem>(),
        layout::<BlockSum>(),
        layout::<GuideUniforms>(),
        layout::<Trail>(),
        layout::<Transition>(),
    ]
}

/// What of a kernel's struct differs from Rust's, if anything; None if the kernel has no such struct.
fn layout_problem(
    module: &naga::Module,
    name: &str,
    fields: &[(&str, usize)],
    size: usize,
) -> Option<Result<(), String>> {
    let (members, span) = module.types.iter().find_map(|(_, ty)| match &ty.inner {
        TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => Some((members, *span)),
        _ => None,
    })?;
    let found: Vec<(&str, usize)> =
        members.iter().map(|m| (m.name.as_deref().unwrap_or(""), m.offset as usize)).collect();
    if found == fields && span as usize == size {
        return Some(Ok(()));
    }
    Some(Err(format!("{name}: kernel has {found:?}, {span} bytes; Rust has {fields:?}, {size} bytes")))
}

/// naga, which computes WGSL's layout rules, agrees with `offset_of!` and `size_of` for every struct in every kernel.
#[test]
fn structs_shared_with_the_kernels_have_equal_offsets_and_sizes() {
    let mut seen = BTreeSet::new();
    let mut kernels = linked(&scene("bansal-room-1"), &usual());
    kernels.extend(linked(&scene("cornell-box"), &usual()));
    kernels.extend(linked(&scene("many-lights"), &usual()));
    kernels.extend(linked(&scene("many-lights"), &learning(LEARNING[2])));
    kernels.extend(linked(&scene("furnace-open"), &learning(LEARNING[6])));
    kernels.extend(linked(&scene("many-lights"), &splitting(4)));
    kernels.extend(linked(&scene("mesh"), &usual()));
    kernels.extend(linked(&scene("surfaces"), &usual()));
    for (kernel, wgsl) in kernels {
        let module = validate(&wgsl);
        for (name, fields, size) in rust_layouts() {
            if let Some(outcome) = layout_problem(&module, name, &fields, size) {
                outcome.unwrap_or_else(|e| panic!("{kernel}: {e}"));
                seen.insert(name);
            }
        }
    }
    assert_eq!(seen.len(), rust_layouts().len(), "no kernel was found that holds the others: {seen:?}");
}

/// Negative control: a field moved, a field widened, a field renamed are each found.
#[test]
fn a_struct_that_differs_is_found() {
    let (name, fields, size) = rust_layouts().into_iter().find(|l| l.0 == "HitItem").unwrap();
    let problem = |declaration: &str| {
        let wgsl = format!("{declaration}\n@group(0) @binding(0) var<storage> items: array<HitItem>;");
        layout_problem(&validate(&wgsl), name, &fields, size).unwrap()
    };
    assert!(problem("struct HitItem { slot: u32, shape: u32, t: f32 }").is_ok());
    assert!(problem("struct HitItem { shape: u32, slot: u32, t: f32 }").is_err());
    assert!(problem("struct HitItem { slot: u32, shape: u32, t: vec2<f32> }").is_err());
    assert!(problem("struct HitItem { slot: u32, shape: u32, distance: f32 }").is_err());
}

/// Values of all literal constants of a kernel, as f64 (exact for u32 and f32).
fn constants(wgsl: &str) -> BTreeMap<String, f64> {
    let module = validate(wgsl);
    let literal = |init: naga::Handle<naga::Expression>| match module.global_expressions[init] {
        naga::Expression::Literal(naga::Literal::U32(v)) => Some(f64::from(v)),
        naga::Expression::Literal(naga::Literal::F32(v)) => Some(f64::from(v)),
        _ => None,
    };
    module.constants.iter().filter_map(|(_, c)| Some((c.name.clone()?, literal(c.init)?))).collect()
}

#[test]
fn constants_shared_with_the_kernels_are_equal() {
    let expected: BTreeMap<&str, f64> = [
        ("GRID_WIDTH", f64::from(GRID_WIDTH)),
        ("LEAF", f64::from(qtracer::scene::bvh::LEAF)),
        ("WORKGROUP", f64::from(WORKGROUP)),
        ("KIND_DIFFUSE", f64::from(compiled::KIND_DIFFUSE)),
        ("KIND_MIRROR", f64::from(compiled::KIND_MIRROR)),
        ("KIND_GLOSSY", f64::from(compiled::KIND_GLOSSY)),
        ("KIND_DIELECTRIC", f64::from(compiled::KIND_DIELECTRIC)),
        ("KIND_METAL", f64::from(compiled::KIND_METAL)),
        ("KIND_METALLIC_ROUGHNESS", f64::from(compiled::KIND_METALLIC_ROUGHNESS)),
        ("KIND_ROUGH_DIELECTRIC", f64::from(compiled::KIND_ROUGH_DIELECTRIC)),
        ("LEAST_ALPHA", f64::from(compiled::LEAST_ALPHA)),
        ("NONE", f64::from(compiled::NONE)),
        ("BELOW_ONE", f64::from(qtracer::sampling::BELOW_ONE)),
        ("ROULETTE_FROM_BOUNCE", f64::from(ROULETTE_FROM_BOUNCE)),
        ("RELATIVE_OFFSET", f64::from(RELATIVE_OFFSET)),
        ("SHADOW_END", f64::from(SHADOW_END)),
        ("T_MISS", f64::from(T_MISS)),
        ("SMALLEST_SQUARE", f64::from(SMALLEST_SQUARE)),
        ("DIMENSION_CAMERA", f64::from(DIMENSION_CAMERA)),
        ("CELL_BITS", f64::from(table::CELL_BITS)),
        ("FINER", f64::from(table::FINER)),
        ("MAX_CELL_LEVELS", f64::from(table::MAX_CELL_LEVELS)),
        ("TICKET_BITS", f64::from(quadtree::TICKET_BITS)),
        ("LEAF_BITS", f64::from(quadtree::LEAF_BITS)),
        ("BLOCK_WORDS", f64::from(quadtree::BLOCK_WORDS)),
        ("FINER_BLOCK", f64::from(quadtree::FINER_BLOCK)),
        ("MAP_LEVELS", f64::from(quadtree::MAP_LEVELS)),
        ("MISSING", f64::from(lessons::MISSING)),
        ("VISIT_UNIT", f64::from(lessons::VISIT_UNIT)),
        ("OCTANT_WORDS", f64::from(commit::OCTANT_WORDS)),
        ("TRUSTED_VISITS", f64::from(commit::TRUSTED_VISITS)),
        ("CELL_STATE_ROWS", f64::from(state::CELL_STATE_ROWS)),
        ("CELL_TREE_WORDS", (size_of::<state::CellTrees>() / 4) as f64),
        // What one addition makes at most.
        ("LARGEST", lessons::fixed(f32::MAX, 1.0) as f64),
        ("LEAST_RADIANCE", f64::from(LEAST_RADIANCE)),
        ("LEAST_SEEN", f64::from(LEAST_SEEN)),
        ("MOST_PROPOSED", f64::from(MOST_PROPOSED)),
        ("BANSAL_DRAWS", f64::from(table::bansal::DRAWS)),
        ("LEAST_SURVIVAL", f64::from(LEAST_SURVIVAL)),
        ("BUDGET_SHIFT", f64::from(BUDGET_SHIFT)),
        ("SEED_SHIFT", f64::from(SEED_SHIFT)),
        ("SPLIT", 5.0),
        ("WRAP_CLAMP", f64::from(texels::WRAP_CLAMP)),
        ("WRAP_MIRROR", f64::from(texels::WRAP_MIRROR)),
        ("WRAP_U_SHIFT", f64::from(texels::WRAP_U_SHIFT)),
        ("WRAP_V_SHIFT", f64::from(texels::WRAP_V_SHIFT)),
        ("PACKED_ONE", f64::from(shading::PACKED_ONE)),
        ("LEAST_COSINE", f64::from(shading::LEAST_COSINE)),
    ]
    .into();
    let mut seen = BTreeSet::new();
    let guided = LEARNING.into_iter().flat_map(|learnt| linked(&scene("bansal-room-1"), &learning(learnt)));
    let split = linked(&scene("bansal-room-1"), &splitting(5));
    let large = linked(&scene("many-lights"), &usual()).into_iter().chain(linked(&scene("mesh"), &usual()));
    let rough = ["metal-spheres", "rough-glass", "surfaces"].into_iter();
    let large = large.chain(rough.flat_map(|name| linked(&scene(name), &usual())));
    let usual = linked(&scene("bansal-room-1"), &usual());
    for (kernel, wgsl) in usual.into_iter().chain(guided).chain(split).chain(large) {
        for (name, value) in constants(&wgsl) {
            if let Some(rust) = expected.get(name.as_str()) {
                let own = kernel.starts_with("megakernel") && name == "WORKGROUP";
                let rust = if own { f64::from(MEGAKERNEL_WORKGROUP) } else { *rust };
                assert_eq!(value, rust, "{name} in {kernel}");
                seen.insert(name);
            }
        }
    }
    let missing: Vec<_> = expected.keys().filter(|name| !seen.contains(**name)).collect();
    assert!(missing.is_empty(), "no kernel has {missing:?}");
}

/// One event's numbers are never another's: the dimensions of 64 levels are all different.
#[test]
fn dimensions_of_all_events_of_a_path_are_different() {
    let events = (0..64).flat_map(|bounce| [dimension_bsdf(bounce), dimension_light(bounce)]);
    let guided = (0..64).flat_map(|bounce| (0..16).map(move |draw| dimension_guide(bounce, draw)));
    let dimensions: BTreeSet<u32> = events.chain(guided).chain([DIMENSION_CAMERA]).collect();
    assert_eq!(dimensions.len(), (2 + 16) * 64 + 1);
    // Bansal's draws stay within a bounce's numbers.
    const { assert!(table::bansal::DRAWS <= 16) };
    // Every place has a seed of its own, bounces stay below the budget, and budgets below the bit that says who waits.
    const { assert!(MAX_SPLIT <= 1 << (32 - SEED_SHIFT) && 64 < 1 << BUDGET_SHIFT) };
    const { assert!(MAX_SPLIT << BUDGET_SHIFT < 1 << 31) };
}

#[test]
fn a_scene_links_the_functions_of_its_own_materials_only() {
    for (own, material) in kinds() {
        for (kernel, wgsl) in linked(&ball(material), &usual()) {
            let functions = names(&wgsl);
            // Rough glass that hardly bends is smooth glass.
            let part = |other: &str| own == "rough_dielectric_" && other == "dielectric_";
            for (other, _) in kinds().iter().filter(|(other, _)| *other != own && !part(other)) {
                let foreign: Vec<_> = functions.iter().filter(|f| f.starts_with(other)).collect();
                assert!(foreign.is_empty(), "{kernel} of a scene with {own}* only has {foreign:?}");
            }
        }
    }
    // Kernels of the sorted schedule know one material of a scene, or all but that one; of one material alone, no surface.
    let sorted = |name: &str, stage: Stage| {
        let key = KernelKey::new(&CompiledScene::new(&scene(name)), &usual());
        names(&link(stage, &key, Schedule::Sorted).unwrap())
    };
    let has = |functions: &BTreeSet<String>, prefix: &str| functions.iter().any(|f| f.starts_with(prefix));
    let [own, others] = [Stage::Follow(0), Stage::FollowOthers].map(|stage| sorted("bansal-room-1", stage));
    assert!(has(&own, "diffuse_") && !has(&own, "glossy_") && !has(&own, "dielectric_"), "{own:?}");
    assert!(
        !has(&others, "diffuse_") && has(&others, "glossy_") && has(&others, "dielectric_"),
        "{others:?}"
    );
    assert!(!sorted("cornell-box", Stage::FollowOthers).contains("shade"));
    // Negative control: scenes with all of them have all of them.
    let scenes = ["bansal-room-1", "metal-spheres", "rough-glass"];
    let all: BTreeSet<String> = scenes
        .iter()
        .flat_map(|name| linked(&scene(name), &usual()))
        .flat_map(|(_, wgsl)| names(&wgsl))
        .collect();
    for (prefix, _) in kinds() {
        assert!(all.iter().any(|f| f.starts_with(prefix)), "no {prefix}* where there should be");
    }
}

/// The third row of a material is read, facets are drawn, and shadow rays leave on the far side only where a material asks
/// for it.
#[test]
fn without_microfacets_nothing_of_them_is_linked() {
    let of_facets = ["alpha_of", "ggx_density", "sample_visible_facet", "smith_root", "to_local", "weighed"];
    let holds = |wgsl: &str| {
        let names = names(wgsl);
        let functions = of_facets.iter().filter(|name| names.contains(**name)).count();
        (functions, wgsl.contains("rough = scene_rows"), wgsl.contains("origin = spawn_ray(surface, -"))
    };
    for name in ["cornell-box", "bansal-room-1", "glass-shelf", "furnace-open"] {
        for (kernel, wgsl) in linked(&scene(name), &usual()) {
            assert_eq!(holds(&wgsl), (0, false, false), "{kernel} of {name}");
        }
    }
    // Of a scene with metal and diffuse walls, shading of the walls neither.
    let kernels = linked(&scene("rough-glass"), &usual());
    let of = |stage: &str| {
        let (_, wgsl) = kernels.iter().find(|(kernel, _)| kernel.starts_with(stage)).unwrap();
        holds(wgsl)
    };
    assert_eq!(of("shade_diffuse"), (0, false, false));
    // Negative control: where they are, they are found.
    assert_eq!(of("shade_metal "), (of_facets.len(), true, false));
    assert_eq!(of("shade_rough_dielectric"), (of_facets.len(), true, true));
}

#[test]
fn a_diffuse_scene_links_one_queue_and_no_glass() {
    let texts = linked(&scene("cornell-box"), &usual());
    let queues = |wgsl: &str| constants(wgsl).get("HIT_QUEUES").copied();
    assert!(texts.iter().any(|(_, wgsl)| queues(wgsl) == Some(1.0)));
    for (kernel, wgsl) in &texts {
        assert!(queues(wgsl).is_none_or(|count| count == 1.0), "{kernel}");
        let names = names(wgsl);
        for name in ["fresnel", "sample_phong", "pdf_phong", "environment", "intersect_sphere", "sphere_test"]
        {
            assert!(!names.contains(name), "{kernel} holds {name}");
        }
    }
}

#[test]
fn without_direct_light_nothing_of_it_is_linked() {
    let off = linked(&scene("cornell-box"), &Estimators { direct_light: false, ..usual() });
    for (kernel, wgsl) in &off {
        let names = names(wgsl);
        for name in
            ["light_at", "shadows", "occluded", "sample_light", "direct_light", "mis_weight", "choose_light"]
        {
            assert!(!names.contains(name), "{kernel} has {name} with direct light off");
        }
        assert!(!kernel.starts_with("shadow"));
    }
    // Negative control: with it on, they are there.
    let on: BTreeSet<String> =
        linked(&scene("cornell-box"), &usual()).iter().flat_map(|(_, wgsl)| names(wgsl)).collect();
    assert!(["light_at", "shadows", "occluded", "sample_light"].iter().all(|name| on.contains(*name)));
}

#[test]
fn without_roulette_nothing_of_it_is_linked() {
    let has = |roulette| {
        linked(&scene("cornell-box"), &Estimators { roulette, ..usual() })
            .iter()
            .any(|(_, wgsl)| names(wgsl).contains("throughput_survival"))
    };
    assert!(has(Roulette::Throughput) && !has(Roulette::Off));
}

/// Functions and buffers that exist where something is learnt: those of kernels/guiding and kernels/transport/guide, and
/// the queue that feeds them.
fn names_of_learning() -> BTreeSet<String> {
    let modules =
        MODULES.iter().filter(|(name, _)| name.starts_with("guiding/") || *name == "transport/guide");
    let functions = modules.flat_map(|(_, text)| text.lines().filter_map(|line| line.strip_prefix("fn ")));
    let identifier = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    let buffers = ["guide", "guide_rows", "guide_state", "guide_trees", "lessons", "transitions"];
    functions.map(identifier).chain(buffers.map(String::from)).collect()
}

#[test]
fn without_guiding_nothing_of_it_is_linked() {
    let learnt = names_of_learning();
    assert!(learnt.len() > 35, "{learnt:?}");
    for name in scene_names() {
        for roulette in [Roulette::Off, Roulette::Throughput] {
            for (kernel, wgsl) in linked(&scene(&name), &Estimators { roulette, ..usual() }) {
                let found: Vec<_> = names(&wgsl).intersection(&learnt).cloned().collect();
                assert!(found.is_empty(), "{name}: {kernel} holds {found:?} with guiding off");
                let module = validate(&wgsl);
                let types = module.types.iter().filter_map(|(_, ty)| ty.name.as_deref());
                let foreign: Vec<_> =
                    types.filter(|t| ["Trail", "Transition", "GuideUniforms"].contains(t)).collect();
                assert!(foreign.is_empty(), "{name}: {kernel} holds {foreign:?} with guiding off");
                assert!(!kernel.starts_with("learn") && !kernel.starts_with("commit"));
            }
        }
    }
    // Negative control: with it on, each of them is somewhere.
    let kernels = || LEARNING.into_iter().flat_map(|learnt| linked(&scene("cornell-box"), &learning(learnt)));
    let all: BTreeSet<String> = kernels().flat_map(|(_, wgsl)| names(&wgsl)).collect();
    let missing: Vec<_> = learnt.difference(&all).collect();
    assert!(missing.is_empty(), "nowhere even with guiding on: {missing:?}");
    assert!(["learn", "commit"].iter().all(|name| kernels().any(|(kernel, _)| kernel.starts_with(name))));
}

/// Without splitting nothing of it is in a kernel: no function, no number, no struct. Passes of `auto` that do without the
/// table do without it, too.
#[test]
fn without_splitting_nothing_of_it_is_linked() {
    let words = [
        "Split",
        "Share",
        "SPLIT",
        "COUNTER_PLACES",
        "BUDGET_SHIFT",
        "SEED_SHIFT",
        "copies",
        "budget",
        "waiting_copy",
        "WAITING",
    ];
    let plain = Estimators { split: 8, ..usual() };
    let scene = scene("bansal-room-1");
    for estimators in [usual(), plain, splitting(1)] {
        for (kernel, wgsl) in linked(&scene, &estimators) {
            let found: Vec<_> = words.iter().filter(|word| wgsl.contains(**word)).collect();
            assert!(found.is_empty(), "{kernel} holds {found:?} without splitting");
        }
    }
    assert_eq!(linked(&scene, &usual()), linked(&scene, &plain));
    // Negative control: with it, each of them is somewhere.
    let text: String = linked(&scene, &splitting(8)).into_iter().map(|(_, wgsl)| wgsl).collect();
    let missing: Vec<_> = words.iter().filter(|word| !text.contains(**word)).collect();
    assert!(missing.is_empty(), "nowhere even with splitting: {missing:?}");
}

/// Each guide links its own densities only.
#[test]
fn a_guide_links_its_own_functions_only() {
    let own = |mode: GuideMode| match mode {
        GuideMode::Adaptive => "adaptive_",
        GuideMode::Octant => "octants_",
        _ => "bansal_",
    };
    for (mode, roulette) in LEARNING.into_iter().filter(|(mode, _)| *mode != GuideMode::Off) {
        let kernels = linked(&scene("cornell-box"), &learning((mode, roulette)));
        let all: BTreeSet<String> = kernels.iter().flat_map(|(_, wgsl)| names(wgsl)).collect();
        for prefix in ["adaptive_", "octants_", "bansal_"] {
            assert_eq!(
                all.iter().any(|name| name.starts_with(prefix)),
                prefix == own(mode),
                "{mode}: {prefix}*"
            );
        }
        assert_eq!(all.contains("bansal_pdf"), mode == GuideMode::BansalReweighted);
        assert_eq!(all.contains("pixel_estimate"), roulette == Roulette::Learnt, "{mode}");
    }
}

/// What browsers grant: 10 storage buffers and 12 uniform buffers of 64 KiB a stage, 256 invocations a workgroup, 16 KiB
/// of workgroup memory. Of the storage buffers two are kept for the guide.
#[test]
fn every_stage_of_every_scene_stays_within_what_browsers_grant() {
    // The guide that binds most, and the one with the most text.
    let all = [usual(), learning(LEARNING[2]), learning(LEARNING[6]), splitting(8)];
    for (name, estimators) in scene_names().iter().flat_map(|name| all.iter().map(move |e| (name, e))) {
        for (kernel, wgsl) in linked(&scene(name), estimators) {
            let module = validate(&wgsl);
            let most = if estimators.learns() { 10 } else { 8 };
            let storage = |space| matches!(space, naga::AddressSpace::Storage { .. });
            let buffers = module.global_variables.iter().filter(|(_, g)| storage(g.space)).count();
            assert!(buffers <= most, "{name}: {kernel} binds {buffers} storage buffers");
            let uniform =
                module.global_variables.iter().filter(|(_, g)| g.space == naga::AddressSpace::Uniform);
            let bytes: Vec<u32> =
                uniform.map(|(_, g)| module.types[g.ty].inner.size(module.to_ctx())).collect();
            assert!(bytes.len() <= 12 && bytes.iter().all(|b| *b <= 64 << 10), "{name}: {kernel}: {bytes:?}");
            assert_eq!(module.entry_points.len(), 1, "{name}: {kernel}");
            let invocations: u32 = module.entry_points[0].workgroup_size.iter().product();
            assert!(invocations <= 256, "{name}: {kernel} has {invocations} invocations");
            let shared: u32 = module
                .global_variables
                .iter()
                .filter(|(_, g)| g.space == naga::AddressSpace::WorkGroup)
                .map(|(_, g)| module.types[g.ty].inner.size(module.to_ctx()))
                .sum();
            assert!(shared <= 16 << 10, "{name}: {kernel} shares {shared} bytes");
        }
    }
}

/// The key alone decides: scenes of one key share every kernel, so compiled ones may be kept by it.
#[test]
fn equal_keys_link_equal_kernels() {
    let (a, b) = (scene("furnace-closed-50"), scene("furnace-closed-99"));
    assert_eq!(linked(&a, &usual()), linked(&b, &usual()));
    assert_ne!(linked(&a, &usual()), linked(&a, &Estimators { roulette: Roulette::Off, ..usual() }));
}

/// The sources with one text replaced by another, which must occur.
fn sabotaged(from: &str, to: &str) -> Vec<(&'static str, String)> {
    assert!(MODULES.iter().any(|(_, text)| text.contains(from)), "no kernel holds {from}");
    MODULES.iter().map(|&(name, text)| (name, text.replace(from, to))).collect()
}

/// Negative control of the linker: what it must refuse, it refuses.
#[test]
fn a_misspelt_flag_or_name_does_not_link() {
    let key = KernelKey::new(&CompiledScene::new(&scene("cornell-box")), &usual());
    let links = |from: &str, to: &str| {
        let modules = sabotaged(from, to);
        let modules: Vec<(&str, &str)> = modules.iter().map(|(name, text)| (*name, text.as_str())).collect();
        let linked = qtracer::gpu::link::link_modules(&modules, Stage::Megakernel, &key, Schedule::Fused);
        linked.map_err(|e| e.to_string()).and_then(|wgsl| {
            naga::front::wgsl::parse_str(&wgsl).map(|_| ()).map_err(|e| e.emit_to_string(&wgsl))
        })
    };
    links("@if(roulette)", "@if(roulette)").unwrap();
    let error = links("@if(roulette)", "@if(roulete)").unwrap_err();
    assert!(error.contains("roulete"), "the error does not name the flag: {error}");
    assert!(links("import package::bsdf::interface::", "import package::bsdf::interfaces::").is_err());
    assert!(links("mis_weight(ray.pdf", "mis_wait(ray.pdf").is_err());
}

/// Buffers of a small wavefront render, by name.
fn buffers(scene: &Scene, schedule: Schedule, direct_light: bool) -> (BTreeMap<String, u64>, u64) {
    let options =
        qtracer::RenderOptions { direct_light: Some(direct_light), pool: Some(512), ..small(32, 32, 1) };
    let stats = render(scene, Engine::Wavefront(schedule), &options, 1).stats;
    (stats.buffers, 512)
}

#[test]
fn buffers_exist_for_what_the_scene_needs_and_nothing_else() {
    let (have, capacity) = buffers(&scene("cornell-box"), Schedule::Compacted, true);
    assert_eq!(have["hits"], 12 * capacity, "one material: one hit queue");
    assert_eq!(have["rays_a"], 48 * capacity);
    assert_eq!(have["rays_b"], 48 * capacity);
    assert_eq!(have["shadows"], 48 * capacity);
    assert_eq!(have["radiance"], 12 * 32 * 32);
    assert_eq!(have["hot_rows"], 16 * (2 * 6 + 4 * 10), "6 aligned quads and 10 others, no spheres");

    // All four materials, no environment, spheres only.
    let (have, _) = buffers(&scene("bansal-room-1"), Schedule::Streamed, true);
    assert_eq!(have["hits"], 4 * 12 * capacity);
    assert_eq!(have["hot_rows"], 16 * 13, "13 spheres, no quads");

    // One material and an environment, no lights.
    let (have, _) = buffers(&scene("furnace-open"), Schedule::Compacted, true);
    assert_eq!(have["hits"], 2 * 12 * capacity);
    assert!(!have.contains_key("shadows"), "{have:?}");

    let (have, _) = buffers(&scene("cornell-box"), Schedule::Compacted, false);
    assert!(!have.contains_key("shadows"), "direct light is off: {have:?}");

    // A large scene is one buffer, in which nothing lies twice: 204 spheres, 24 quads, and 64 bytes for each split of these.
    let (have, _) = buffers(&scene("many-lights"), Schedule::Streamed, true);
    let large = CompiledScene::new(&scene("many-lights"));
    let shapes = Sphere::ROWS * large.spheres.len() + Quad::ROWS * large.quads.len();
    let nodes = 4 * (large.spheres.len() + large.quads.len() - 1);
    let clusters = large.light_tree.as_ref().map_or(0, |tree| tree.clusters.len());
    // None of its materials is rough.
    let rest = rows::MATERIAL_HOT_ROWS * large.materials.len() + 2 * large.lights.len() + 3 * clusters;
    assert_eq!(have["scene_rows"], 16 * (shapes + nodes + rest) as u64);
    assert!(!have.contains_key("hot_rows"), "{have:?}");

    // What learns is a table, its sums and, where hits have queues, a queue of transitions; rays then remember more.
    let (have, capacity) = buffers(&scene("cornell-box"), Schedule::Compacted, true);
    for name in ["guide", "guide_rows", "guide_state", "guide_trees", "lessons", "transitions"] {
        assert!(!have.contains_key(name), "{name} with guiding off: {have:?}");
    }
    for schedule in SCHEDULES {
        let mut options = qtracer::RenderOptions { pool: Some(512), ..small(32, 32, 1) };
        options.guide.mode = GuideMode::Octant;
        let have = render(&scene("cornell-box"), Engine::Wavefront(schedule), &options, 1).stats.buffers;
        let learnt = ["guide", "guide_rows", "guide_state", "guide_trees", "lessons"];
        assert!(learnt.iter().all(|name| have.contains_key(*name)), "{have:?}");
        assert_eq!((have["rays_a"], have["rays_b"]), (64 * capacity, 64 * capacity));
        let whole_levels = matches!(schedule, Schedule::Fused | Schedule::Sorted);
        let queue = (!whole_levels).then_some(16 * capacity);
        assert_eq!(have.get("transitions").copied(), queue, "{schedule:?}");
        assert_eq!(have.get("shadows").copied(), queue.map(|bytes| 4 * bytes), "{schedule:?}");
    }

    // Where paths split they have more places for radiance; rays are no larger, and there are no other buffers.
    let learns = |split| {
        let mut options = qtracer::RenderOptions { pool: Some(512), split, ..small(32, 32, 1) };
        options.guide.mode = GuideMode::Adaptive;
        render(&scene("cornell-box"), Engine::Wavefront(Schedule::Compacted), &options, 1).stats.buffers
    };
    let [whole, mut split] = [None, Some(4)].map(learns);
    assert_eq!(whole["radiance"], split["radiance"], "a batch has fewer paths, and so no more places");
    let smaller = split.insert("block_sums".to_string(), whole["block_sums"]);
    assert!(smaller.is_some_and(|bytes| bytes < whole["block_sums"]));
    assert_eq!(whole, split);

    // The fused schedule shades where it intersects.
    let (have, _) = buffers(&scene("cornell-box"), Schedule::Fused, true);
    assert!(!have.contains_key("hits") && !have.contains_key("shadows"), "{have:?}");

    // The sorted one has two sets of lists, one for each material, and none for the environment.
    let (have, _) = buffers(&scene("furnace-open"), Schedule::Sorted, true);
    assert_eq!((have["hits_a"], have["hits_b"]), (12 * capacity, 12 * capacity));
    assert!(!have.contains_key("hits") && !have.contains_key("shadows"), "{have:?}");
    let (have, _) = buffers(&scene("bansal-room-1"), Schedule::Sorted, true);
    assert_eq!((have["hits_a"], have["hits_b"]), (4 * 12 * capacity, 4 * 12 * capacity));
    let (have, _) = buffers(&scene("bansal-room-1"), Schedule::Streamed, true);
    assert!(!have.contains_key("hits_a") && !have.contains_key("hits_b"), "{have:?}");
}

/// Functions of kernels/transport/light_tree and what they read.
#[test]
fn with_few_lights_nothing_of_the_light_tree_is_linked() {
    let of_tree = ["choose_in_tree", "probability_in_tree", "importance", "light_cluster_at", "LightCluster"];
    for name in scene_names().iter().filter(|name| *name != "many-lights") {
        for (kernel, wgsl) in linked(&scene(name), &usual()) {
            assert!(of_tree.iter().all(|of| !wgsl.contains(of)), "{name}: {kernel} knows of a light tree");
        }
    }
    // Negative control, and the other way round: what chooses by power is not there where a tree is.
    let all: BTreeSet<String> =
        linked(&scene("many-lights"), &usual()).iter().flat_map(|(_, wgsl)| names(wgsl)).collect();
    assert!(of_tree[..4].iter().all(|name| all.contains(*name)));
    assert!(!all.contains("choose_by_power"));
}
