//! What travels between passes: of guides without quadtrees nothing where no cell was made, of those with them what is known
//! only where a shape changed; and table and knowledge are the host's all the same.

use super::*;
use crate::engine::cpu::CpuEngine;
use crate::engine::gpu_film::{GpuFilm, Keys};
use crate::engine::megakernel::MegakernelEngine;
use crate::engine::tracer::Tracer;
use crate::engine::{CancelToken, EngineKind, RenderStats, Renderer};
use crate::gpu::device::Gpu;
use crate::gpu::key::KernelKey;
use crate::guiding::state::Row;
use crate::guiding::table::{FINER, NO_CELL};
use crate::guiding::{Committed, GuideState, GuideTable, GuideUpdate};
use crate::scene::Scene;
use std::ops::Range;
use std::time::Duration;

/// An engine, and what came with each of the tables that it was given: rows, what is known.
struct Watched<E> {
    engine: E,
    anew: Vec<[bool; 2]>,
}

impl<E: Engine> Engine for Watched<E> {
    fn kind(&self) -> EngineKind {
        self.engine.kind()
    }
    fn device(&self) -> String {
        self.engine.device()
    }
    fn render(
        &mut self,
        range: Range<u32>,
        film: &mut Film,
        cancel: &CancelToken,
    ) -> Result<(), RenderError> {
        self.engine.render(range, film, cancel)
    }
    fn set_pass(&mut self, pass: &Pass) -> Result<(), RenderError> {
        self.engine.set_pass(pass)
    }
    fn set_guide(&mut self, update: GuideUpdate) -> Result<(), RenderError> {
        self.anew.push([update.rows.is_some(), update.state.is_some()]);
        self.engine.set_guide(update)
    }
    fn begin_commit(&mut self) {
        self.engine.begin_commit();
    }
    fn commit(&mut self) -> Result<Committed, RenderError> {
        self.engine.commit()
    }
    fn step_samples(&self) -> u32 {
        self.engine.step_samples()
    }
    fn stats(&self) -> RenderStats {
        self.engine.stats()
    }
}

/// Numbers of a table's cells and of what is known, and other words.
fn contents(mode: GuideMode, table: &GuideTable, state: &GuideState) -> (Vec<f32>, Vec<u32>) {
    let (index, behind) = table.rows.split_at(table.uniforms.words_at as usize);
    let mut numbers: Vec<f32> = bytemuck::pod_collect_to_vec(&state.cells);
    numbers.extend(state.nodes.as_flattened());
    let mut words = Vec::new();
    for &[at, number, irradiance, trust] in index {
        words.extend([at, number]);
        if number != NO_CELL && number & FINER == 0 {
            numbers.extend([irradiance, trust].map(f32::from_bits));
        }
    }
    match mode {
        GuideMode::Adaptive => words.extend(behind.as_flattened()),
        _ => numbers.extend(behind.as_flattened().iter().map(|word| f32::from_bits(*word))),
    }
    (numbers, words)
}

/// Whether tables are equal, to what divisions of GPUs leave.
fn alike(a: &(Vec<f32>, Vec<u32>), b: &(Vec<f32>, Vec<u32>)) -> bool {
    let close = |(a, b): (&f32, &f32)| (a - b).abs() <= 2e-6 * a.abs().max(b.abs());
    a.1 == b.1 && a.0.len() == b.0.len() && a.0.iter().zip(&b.0).all(close)
}

/// Renders five passes; after each the engine's table must be what the host lays out, and what it knows what the host does.
/// What came anew with each table. `read` gives rows, as many as there should be, and what is known, in a state like that.
fn watch<E: Engine>(
    mode: GuideMode,
    make: impl Fn(&CompiledScene, Uniforms, Estimators, &RenderOptions) -> E,
    read: impl Fn(&E, usize, &GuideState) -> (Vec<Row>, GuideState),
) -> Vec<[bool; 2]> {
    let path = format!("{}/scenes/cornell-box.toml", env!("CARGO_MANIFEST_DIR"));
    let scene = Scene::load(path).expect("the scene loads");
    // Cells so large that paths have met them all before long.
    let guide =
        GuideOptions { mode, learning_samples: Some(30), cell_size: Some(200.0), ..Default::default() };
    let options = RenderOptions { guide, size: Some((16, 16)), max_bounces: Some(8), ..Default::default() };
    let (compiled, estimators) = (CompiledScene::new(&scene), options.estimators(&scene));
    let uniforms = Uniforms { max_bounces: 8, ..compiled.uniforms(&scene.camera, 16, 16, 1) };
    let engine = make(&compiled, uniforms, estimators, &options);
    let mut watched = Watched { engine, anew: Vec::new() };
    let mut guided = Guided::start(&options, estimators, &compiled, &uniforms, &mut watched)
        .expect("it starts")
        .expect("it learns");
    let (mut film, mut samples) = (Film::new(16, 16), 0);
    let mut before = Default::default();
    while samples < 62 {
        let end = guided.end().min(62);
        watched.render(samples..end, &mut film, &CancelToken::default()).expect("it renders");
        samples = end;
        let taught = guided.pass.teaches();
        guided.conclude_pass(samples, &film, &mut watched).expect("the pass ends");
        let expected = guided.learner().table(true, &[]);
        let known = guided.learner().state();
        let (rows, state) = read(&watched.engine, expected.rows.len(), known);
        let found = contents(mode, &GuideTable { rows, ..expected.clone() }, &state);
        let expected = contents(mode, &expected, known);
        assert!(alike(&found, &expected), "{mode} after {samples} samples");
        // Negative control: the table of the pass before is another.
        assert!(!taught || !alike(&found, &before), "{mode} after {samples} samples: nothing was learnt");
        before = expected;
    }
    watched.anew
}

fn cpu(mode: GuideMode) -> Vec<[bool; 2]> {
    watch(
        mode,
        |scene, uniforms, estimators, _| CpuEngine::new(scene.clone(), uniforms, estimators),
        |engine, count, _| {
            let (rows, state) = engine.guide().expect("it is guided");
            (rows[..count].to_vec(), state.clone())
        },
    )
}

/// What a GPU has of a guide.
fn read(film: &GpuFilm, rows: usize, like: &GuideState) -> (Vec<Row>, GuideState) {
    let (cells, nodes) = (size_of_val(&*like.cells), size_of_val(&*like.nodes));
    let wanted = [("guide_rows", 16 * rows), ("guide_state", cells + nodes)];
    let wanted = wanted.map(|(name, bytes)| (film.buffers.get(name), bytes as u64));
    let read = film.gpu.read(&wanted).expect("it is read");
    let (of_cells, of_nodes) = read[1].split_at(cells);
    let cells = bytemuck::pod_collect_to_vec(of_cells);
    let state = GuideState { cells, nodes: bytemuck::pod_collect_to_vec(of_nodes), ..like.clone() };
    (bytemuck::pod_collect_to_vec(&read[0]), state)
}

fn megakernel(mode: GuideMode) -> Vec<[bool; 2]> {
    watch(
        mode,
        |scene, uniforms, estimators, options| {
            let adapter = std::env::var("QTRACER_TEST_ADAPTER").ok();
            let gpu = Gpu::open(adapter.as_deref()).expect("GPU tests need an adapter: run tests/run");
            let keys = Keys { own: KernelKey::new(scene, &estimators), plain: None };
            MegakernelEngine::new(gpu, scene, uniforms, keys, options).expect("the engine starts")
        },
        |engine, rows, like| read(engine.gpu(), rows, like),
    )
}

#[test]
fn what_is_not_stale_is_not_uploaded_and_is_the_hosts() {
    for mode in [GuideMode::Octant, GuideMode::Bansal, GuideMode::BansalReweighted] {
        for anew in [cpu(mode), megakernel(mode)] {
            // The first is the pilot's; the second may have cells that it missed.
            assert!(anew[0] == [true; 2] && anew.len() >= 5, "{mode}: {anew:?}");
            assert!(anew[2..].contains(&[false; 2]) && !anew.contains(&[true, false]), "{mode}: {anew:?}");
        }
    }
    // Quadtrees grow in some of the passes, when enough is known; tickets change in all.
    for anew in [cpu(GuideMode::Adaptive), megakernel(GuideMode::Adaptive)] {
        let kinds = [[true; 2], [true, false]];
        assert!(kinds.iter().all(|kind| anew[1..].contains(kind)), "{anew:?}");
        assert!(anew.iter().all(|kind| kinds.contains(kind)), "{anew:?}");
    }
}

/// While few samples have followed, earlier ones keep their weight.
#[test]
fn earlier_samples_fade_by_how_many_follow() {
    assert_eq!([faded(72, 0), faded(72, 8), faded(72, 72)], [1.0; 3]);
    let eighth = [faded(128, 256 * 128), faded(1, 1 << 16)];
    assert!(eighth.iter().zip([0.5, 0.25]).all(|(a, b)| (a - b).abs() < 1e-12), "{eighth:?}");
    assert_eq!(faded(0, 100), 0.0);
}

/// 40 samples with a guide, on trial or not.
fn rendered(name: &str, trial: bool) -> Renderer {
    rendered_of(name, trial, Budget::default(), 40)
}

/// 40 samples of a budget, at first so many.
fn rendered_of(name: &str, trial: bool, budget: Budget, first: u32) -> Renderer {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let scene = Scene::load(path).expect("the scene loads");
    let guide = GuideOptions { mode: GuideMode::Adaptive, trial, ..Default::default() };
    let options = RenderOptions { guide, budget, size: Some((16, 12)), ..RenderOptions::cpu() };
    let mut renderer = Renderer::new(&scene, options).expect("it starts");
    renderer.step(first).expect("it renders");
    while renderer.samples() < 40 {
        renderer.step(40 - renderer.samples()).expect("it renders");
    }
    renderer
}

/// Whatever the steps are, nothing is learnt where too few samples are to come to win it back. A sample takes microseconds to
/// milliseconds.
#[test]
fn the_budget_tells_whether_a_guide_is_tried() {
    let (few, many) = (Duration::from_nanos(1), Duration::from_secs(100_000));
    for first in [1, 40] {
        let of = |samples, time, error| Budget { samples, time, error };
        for (budget, tried) in [
            (of(None, None, None), true),
            (of(Some(40), None, None), false),
            (of(Some(100_000), None, None), true),
            (of(None, Some(few), None), false),
            (of(None, Some(many), None), true),
            (of(Some(40), Some(many), None), false),
            (of(None, None, Some(0.5)), false),
            (of(None, None, Some(1e-4)), true),
        ] {
            let renderer = rendered_of("bansal-room-5", true, budget, first);
            let learnt = renderer.learner().expect("it may learn").samples() > 0;
            assert_eq!(learnt, tried, "{budget:?}, {first} samples first");
        }
    }
}

/// Of the sum by weights, not of the film's plain one.
#[test]
fn the_error_of_a_render_is_that_of_its_image() {
    let renderer = rendered("cornell-box", false);
    let image = renderer.image();
    let errors = image.standard_error.expect("it has errors");
    let squares = image.rgb.as_flattened().iter().zip(errors.as_flattened());
    let mean: f64 = squares.map(|(v, e)| f64::from(e * e) / (f64::from(v * v) + 0.01)).sum::<f64>()
        / (3.0 * errors.len() as f64);
    let (found, film) = (renderer.relative_error(), renderer.film().relative_error());
    assert!((found / mean.sqrt() - 1.0).abs() < 1e-4, "{found} for {}", mean.sqrt());
    assert!((film / found - 1.0).abs() > 1e-2, "{film}, that of the film, for {found}");
}

/// Plain samples that turn out to suffice are one pass with what follows: the image is the film's plain mean. With a guide it is
/// not, since passes weigh by their noise.
#[test]
fn a_prelude_that_goes_on_is_one_pass() {
    let distance = |name: &str, trial: bool| {
        let renderer = rendered(name, trial);
        let (image, plain) = (renderer.image().rgb, renderer.film().mean());
        let pairs = image.as_flattened().iter().zip(plain.as_flattened());
        pairs.map(|(a, b)| (a - b).abs() / b.abs().max(1e-6)).fold(0.0f32, f32::max)
    };
    assert!(distance("metal-spheres", true) < 1e-6, "{}", distance("metal-spheres", true));
    assert!(distance("metal-spheres", false) > 1e-4, "{}", distance("metal-spheres", false));
}
