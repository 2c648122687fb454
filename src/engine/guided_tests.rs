//! What travels between passes: nothing of cells and nodes where no shape changed, and the table is the host's all the same.

use super::*;
use crate::engine::cpu::CpuEngine;
use crate::engine::gpu_film::Keys;
use crate::engine::megakernel::MegakernelEngine;
use crate::engine::tracer::Tracer;
use crate::engine::{CancelToken, EngineKind, RenderStats};
use crate::gpu::device::Gpu;
use crate::gpu::key::KernelKey;
use crate::guiding::state::Row;
use crate::guiding::{Committed, GuideTable, GuideUniforms, GuideUpdate};
use crate::scene::Scene;
use std::ops::Range;

/// An engine, and which of the tables that it was given came anew.
struct Watched<E> {
    engine: E,
    anew: Vec<bool>,
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
    fn set_guide(&mut self, update: &GuideUpdate) -> Result<(), RenderError> {
        self.anew.push(update.anew.is_some());
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

/// Numbers of a table's cells and nodes, and their words.
fn contents(uniforms: &GuideUniforms, rows: Vec<Row>) -> (Vec<f32>, Vec<u32>) {
    let table = GuideTable { uniforms: *uniforms, rows };
    let cells: Vec<_> = (0..uniforms.cell_count).map(|i| table.cell(i)).collect();
    let nodes: Vec<_> = (0..uniforms.node_count).map(|i| table.node(i)).collect();
    let of_cells =
        cells.iter().flat_map(|cell| cell.octants.into_iter().chain([cell.irradiance, cell.trust]));
    let of_nodes = nodes.iter().flat_map(|node| [node.low_phi, node.low_z[0], node.low_z[1]]);
    let words = cells.iter().map(|cell| cell.roots).chain(nodes.iter().map(|node| node.children));
    (of_cells.chain(of_nodes).collect(), words.collect())
}

/// Whether tables are equal, to what divisions of GPUs leave.
fn alike(a: &(Vec<f32>, Vec<u32>), b: &(Vec<f32>, Vec<u32>)) -> bool {
    let close = |(a, b): (&f32, &f32)| (a - b).abs() <= 2e-6 * a.abs().max(b.abs());
    a.1 == b.1 && a.0.len() == b.0.len() && a.0.iter().zip(&b.0).all(close)
}

/// Renders five passes; after each the engine's table must be what the host lays out. Which tables came anew.
fn watch<E: Engine>(
    mode: GuideMode,
    make: impl Fn(&CompiledScene, Uniforms, Estimators, &RenderOptions) -> E,
    rows: impl Fn(&E, usize) -> Vec<Row>,
) -> Vec<bool> {
    let path = format!("{}/scenes/cornell-box.toml", env!("CARGO_MANIFEST_DIR"));
    let scene = Scene::load(path).expect("the scene loads");
    // Cells so large that paths have met them all before long.
    let guide = GuideOptions { mode, learning_samples: 30, cell_size: Some(200.0), ..Default::default() };
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
        let found = contents(&expected.uniforms, rows(&watched.engine, expected.rows.len()));
        let expected = contents(&expected.uniforms, expected.rows);
        assert!(alike(&found, &expected), "{mode} after {samples} samples");
        // Negative control: the table of the pass before is another.
        assert!(!taught || !alike(&found, &before), "{mode} after {samples} samples: nothing was learnt");
        before = expected;
    }
    watched.anew
}

fn cpu(mode: GuideMode) -> Vec<bool> {
    watch(
        mode,
        |scene, uniforms, estimators, _| CpuEngine::new(scene.clone(), uniforms, estimators),
        |engine, _| engine.guide_rows(),
    )
}

fn megakernel(mode: GuideMode) -> Vec<bool> {
    watch(
        mode,
        |scene, uniforms, estimators, options| {
            let adapter = std::env::var("QTRACER_TEST_ADAPTER").ok();
            let gpu = Gpu::open(adapter.as_deref()).expect("GPU tests need an adapter: run tests/run");
            let keys = Keys { own: KernelKey::new(scene, &estimators), plain: None };
            MegakernelEngine::new(gpu, scene, uniforms, keys, options).expect("the engine starts")
        },
        |engine, rows| {
            let film = engine.gpu();
            let read =
                film.gpu.read(&[(film.buffers.get("guide_rows"), 16 * rows as u64)]).expect("it is read");
            bytemuck::pod_collect_to_vec(&read[0])
        },
    )
}

#[test]
fn what_keeps_its_shape_is_not_uploaded_and_is_the_hosts_table() {
    for mode in [GuideMode::Octant, GuideMode::Bansal, GuideMode::BansalReweighted] {
        for anew in [cpu(mode), megakernel(mode)] {
            // The first is the pilot's; the second may have cells that it missed.
            assert!(anew[0] && anew.len() >= 5 && anew[2..].iter().any(|anew| !anew), "{mode}: {anew:?}");
        }
    }
    // Quadtrees grow in some of the passes, when enough is known.
    for anew in [cpu(GuideMode::Adaptive), megakernel(GuideMode::Adaptive)] {
        assert!(anew[1..].contains(&true) && anew.contains(&false), "{anew:?}");
    }
}
