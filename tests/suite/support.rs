//! What the tests share: scenes, renders, the adapter under test.

use glam::DVec3;
use qtracer::film::Film;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::stage::Schedule;
use qtracer::guiding::GuideMode;
use qtracer::scene::MeshData;
use qtracer::scene::compiled::{CompiledScene, ShapeIndex};
use qtracer::transport::estimators::Estimators;
use qtracer::transport::roulette::Roulette;
use qtracer::{EngineChoice, Image, RenderOptions, RenderStats, Renderer, Sampler, Scene};
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Once;

/// Every way of rendering: the same transport, so the same image.
pub const ENGINES: [Engine; 6] = [
    Engine::Cpu,
    Engine::Megakernel,
    Engine::Wavefront(Schedule::Compacted),
    Engine::Wavefront(Schedule::Streamed),
    Engine::Wavefront(Schedule::Fused),
    Engine::Wavefront(Schedule::Sorted),
];
pub const GPU_ENGINES: [Engine; 5] = [ENGINES[1], ENGINES[2], ENGINES[3], ENGINES[4], ENGINES[5]];
pub const SCHEDULES: [Schedule; 4] =
    [Schedule::Compacted, Schedule::Streamed, Schedule::Fused, Schedule::Sorted];
/// Those in which paths may split.
pub const SPLITTING_SCHEDULES: [Schedule; 3] = [SCHEDULES[0], SCHEDULES[1], SCHEDULES[2]];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    Cpu,
    Megakernel,
    Wavefront(Schedule),
}

impl Engine {
    /// `options` on this engine, and on the adapter under test.
    pub fn with(self, options: &RenderOptions) -> RenderOptions {
        let (engine, schedule) = match self {
            Engine::Cpu => (EngineChoice::Cpu, None),
            Engine::Megakernel => (EngineChoice::Megakernel, None),
            Engine::Wavefront(schedule) => (EngineChoice::Wavefront, Some(schedule)),
        };
        RenderOptions { engine, schedule, adapter: adapter(), ..options.clone() }
    }
}

/// Part of the name of the adapter to test, from `QTRACER_TEST_ADAPTER`; the best one if that is not set.
pub fn adapter() -> Option<String> {
    std::env::var("QTRACER_TEST_ADAPTER").ok()
}

/// The adapter under test.
pub fn open_gpu() -> Gpu {
    Gpu::open(adapter().as_deref())
        .unwrap_or_else(|e| panic!("{e}\nGPU tests need an adapter: run tests/run"))
}

/// Whether the adapter under test computes as the program says: no product fused with a sum, roots, sines and quotients as
/// exact as a CPU's. Others may do what WGSL allows, so what is equal in every bit here is equal within roundings there.
pub fn computes_to_the_letter(gpu: &Gpu) -> bool {
    gpu.summary.software
}

/// Where the repository lies.
pub fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

pub fn scene(name: &str) -> Scene {
    Scene::load(root().join(format!("scenes/{name}.toml"))).unwrap_or_else(|e| panic!("{e}"))
}

/// A sphere of 20 · 4^levels triangles, outwards: a closed surface in which each edge is shared by two.
pub fn icosphere(levels: u32) -> MeshData {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let around = |i: usize, a: f64, b: f64| DVec3::from_array([[0.0, a, b], [a, b, 0.0], [b, 0.0, a]][i]);
    let corners =
        (0..12).map(|i| around(i / 4, [-1.0, 1.0][i % 2], [-golden, golden][i / 2 % 2]).normalize());
    let mut positions: Vec<DVec3> = corners.collect();
    let near = |a: usize, b: usize| positions[a].distance(positions[b]) < 1.1;
    let mut triangles = Vec::new();
    for (a, b, c) in (0..12).flat_map(|a| (0..a).flat_map(move |b| (0..b).map(move |c| (a, b, c)))) {
        if near(a, b) && near(b, c) && near(c, a) {
            let outwards = positions[a].cross(positions[b]).dot(positions[c]) > 0.0;
            triangles.push((if outwards { [a, b, c] } else { [a, c, b] }).map(|i| i as u32));
        }
    }
    assert_eq!(triangles.len(), 20);
    for _ in 0..levels {
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push((positions[a as usize] + positions[b as usize]).normalize());
                positions.len() as u32 - 1
            })
        };
        let split = |&[a, b, c]: &[u32; 3]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.iter().flat_map(split).collect();
    }
    MeshData { positions, triangles, ..Default::default() }
}

/// Names of all scenes, sorted.
pub fn scene_names() -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(root().join("scenes"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert!(names.len() >= 15, "scenes are missing: {names:?}");
    names
}

/// Options of a small render. Samples are independent, so that standard errors are what they say.
pub fn small(width: u32, height: u32, seed: u32) -> RenderOptions {
    RenderOptions { size: Some((width, height)), seed, sampler: Sampler::Independent, ..Default::default() }
}

/// Estimators as a scene's defaults would have them, with this guide and this roulette.
pub fn estimators(guide: GuideMode, roulette: Roulette) -> Estimators {
    Estimators {
        direct_light: true,
        roulette,
        roulette_scale: 1.0,
        split: 1,
        sampler: Sampler::Stratified,
        max_bounces: 64,
        guide,
    }
}

/// A finished render.
pub struct Render {
    pub film: Film,
    pub image: Image,
    pub stats: RenderStats,
}

/// Renders `spp` samples per pixel, in steps as the engine likes them.
pub fn render(scene: &Scene, engine: Engine, options: &RenderOptions, spp: u32) -> Render {
    render_in_steps(scene, engine, options, spp, u32::MAX)
}

/// Renders `spp` samples per pixel of a scene that may lose some.
pub fn render_lossy(scene: &Scene, engine: Engine, options: &RenderOptions, spp: u32) -> Render {
    render_any(scene, engine, options, spp, u32::MAX)
}

/// Renders `spp` samples per pixel in steps of at most `step`. Whatever is rendered, no sample is lost.
pub fn render_in_steps(
    scene: &Scene,
    engine: Engine,
    options: &RenderOptions,
    spp: u32,
    step: u32,
) -> Render {
    let found = render_any(scene, engine, options, spp, step);
    assert_eq!(found.stats.lost_samples, 0, "{engine:?} on {}: samples that are no numbers", scene.name);
    found
}

thread_local! {
    /// What this test rendered, with seeds, the last first.
    static RENDERED: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}
static TELL_SEEDS: Once = Once::new();

/// Notes a render, so that a test which fails says what it rendered with which seed.
fn note(scene: &Scene, engine: Engine, options: &RenderOptions) {
    TELL_SEEDS.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            usual(panic);
            RENDERED.with_borrow(|all| eprintln!("rendered in this test, last first: {}", all.join(", ")));
        }));
    });
    let what = format!("{} on {engine:?} with seed {}", scene.name, options.seed);
    RENDERED.with_borrow_mut(|all| {
        all.insert(0, what);
        all.truncate(8);
    });
}

fn render_any(scene: &Scene, engine: Engine, options: &RenderOptions, spp: u32, step: u32) -> Render {
    note(scene, engine, options);
    let mut renderer = Renderer::new(scene, engine.with(options)).unwrap_or_else(|e| {
        panic!("{engine:?} on {}: {e}\nGPU tests need an adapter: run tests/run", scene.name)
    });
    while renderer.samples() < spp {
        let wanted = (spp - renderer.samples()).min(step);
        renderer.step(wanted).unwrap_or_else(|e| panic!("{engine:?} on {}: {e}", scene.name));
    }
    Render { film: renderer.film().clone(), image: renderer.image(), stats: renderer.stats() }
}

/// The image with every colour times `factor`, its errors unchanged: what a negative control compares.
pub fn brightened(image: &Image, factor: f32) -> Image {
    Image { rgb: image.rgb.iter().map(|rgb| rgb.map(|v| v * factor)).collect(), ..image.clone() }
}

/// How many sums of the two films differ in any bit.
pub fn differing_pixels(a: &Film, b: &Film) -> usize {
    assert_eq!(a.pixels().len(), b.pixels().len());
    let same =
        |(a, b): &(&_, &_)| bytemuck::bytes_of(*a) == bytemuck::bytes_of::<qtracer::film::PixelSum>(*b);
    a.pixels().iter().zip(b.pixels()).filter(|pair| !same(pair)).count()
}

/// Index among the quads of a shape number, None if it is no quad.
pub fn quad_index(scene: &CompiledScene, shape: u32) -> Option<usize> {
    match scene.shape_index(shape) {
        ShapeIndex::Quad(i) => Some(i),
        _ => None,
    }
}
