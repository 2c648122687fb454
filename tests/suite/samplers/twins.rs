//! Functions that exist twice, in Rust and in the kernels: the same questions to both, and laws over many of them that
//! shrink what breaks them.

use crate::guiding_maths::cases;
use crate::probe::{Input, Probe};
use crate::support::{computes_to_the_letter, estimators, open_gpu};
use glam::{DVec3, Vec3};
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::TestRunner;
use qtracer::Sampler;
use qtracer::accel::Search;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::key::KernelKey;
use qtracer::guiding::GuideMode;
use qtracer::scene::Camera;
use qtracer::scene::compiled::{CompiledScene, KINDS, Material, NONE, Sphere, Uniforms};
use qtracer::scene::rows::{self, Row};
use qtracer::transport::estimators::Estimators;
use qtracer::transport::path::Transport;
use qtracer::transport::roulette::Roulette;
use std::cell::Cell;
use wgpu::BufferUsages;

/// What functions read besides their questions.
pub struct World {
    pub scene: CompiledScene,
    pub search: Search<'static>,
    pub uniforms: Uniforms,
    pub sampler: Sampler,
}

/// A camera that looks along −z from the origin.
pub fn camera(fov_y_deg: f64) -> Camera {
    let (origin, target, up) = (DVec3::ZERO, DVec3::NEG_Z, DVec3::Y);
    Camera { origin, target, up, fov_y_deg, width: 1, height: 1 }
}

impl World {
    pub fn of(scene: CompiledScene) -> World {
        let uniforms = scene.uniforms(&camera(45.0), 1, 1, 0);
        let search = Search::new(Box::leak(Box::new(scene.clone())));
        World { search, scene, uniforms, sampler: Sampler::Independent }
    }

    /// A ball of every kind of material.
    pub fn of_all_materials() -> World {
        let ball = |kind| {
            let center = Vec3::new(3.0 * kind as f32, 0.0, 0.0);
            Sphere { center, radius: 1.0, material: kind, kind, light: NONE, ..Default::default() }
        };
        let material = |kind| Material { color: Vec3::ONE, kind, ..Default::default() };
        let kinds = 0..KINDS as u32;
        World::of(CompiledScene {
            spheres: kinds.clone().map(ball).collect(),
            materials: kinds.map(material).collect(),
            ..Default::default()
        })
    }

    /// As the kernels of [`Twins`] are linked.
    pub fn transport(&self) -> Transport<'_> {
        let plain = Transport::plain(&self.scene, &self.search, &self.uniforms);
        Transport { direct_light: self.scene.has_light_to_sample(), sampler: self.sampler, ..plain }
    }

    fn key(&self) -> KernelKey {
        let estimators = estimators(GuideMode::Off, Roulette::Throughput);
        KernelKey::new(&self.scene, &Estimators { sampler: self.sampler, ..estimators })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Cpu,
    Gpu,
}
pub const SIDES: [Side; 2] = [Side::Cpu, Side::Gpu];

/// A function on both sides: of `Q` rows of words to `A`.
pub struct Twins<'a, const Q: usize, const A: usize> {
    gpu: Gpu,
    kernel: Probe<Q, A>,
    rust: fn(&World, &[Row; Q]) -> [Row; A],
    world: &'a World,
}

impl<'a, const Q: usize, const A: usize> Twins<'a, Q, A> {
    /// `imports` and `body` as in [`Probe::new`].
    pub fn new(
        world: &'a World,
        (imports, body): (&str, &str),
        rust: fn(&World, &[Row; Q]) -> [Row; A],
    ) -> Self {
        let gpu = open_gpu();
        let kernel = Probe::new(&gpu, &world.key(), imports, body);
        Twins { gpu, kernel, rust, world }
    }

    /// See [`computes_to_the_letter`].
    pub fn compute_to_the_letter(&self) -> bool {
        computes_to_the_letter(&self.gpu)
    }

    pub fn answer(&self, side: Side, questions: &[[Row; Q]]) -> Vec<[Row; A]> {
        if side == Side::Cpu {
            return questions.iter().map(|question| (self.rust)(self.world, question)).collect();
        }
        let scene = &self.world.scene;
        let (packed, hot) = (rows::pack(scene), rows::hot(scene));
        let hot = if scene.is_small() { hot } else { Vec::new() };
        let inputs: [Input<'_>; 3] = [
            ("uniforms", bytemuck::bytes_of(&self.world.uniforms), BufferUsages::UNIFORM),
            ("scene_rows", bytemuck::cast_slice(&packed), BufferUsages::STORAGE),
            ("hot_rows", bytemuck::cast_slice(&hot), BufferUsages::UNIFORM),
        ];
        self.kernel.ask(&self.gpu, &inputs, questions)
    }
}

/// Holds `count` values to a law by asking about all of them at once. The first that breaks it is shrunk as by proptest, and
/// told with its fault. `faults` says of each value what is wrong with it, if anything.
pub fn all_obey<S: Strategy>(
    law: &str,
    strategy: S,
    count: usize,
    faults: impl Fn(&[S::Value]) -> Vec<Option<String>>,
) where
    S::Value: Clone,
{
    let mut runner = TestRunner::new(cases(1));
    let mut trees: Vec<S::Tree> = (0..count).map(|_| strategy.new_tree(&mut runner).unwrap()).collect();
    let values: Vec<S::Value> = trees.iter().map(S::Tree::current).collect();
    let found = faults(&values).into_iter().enumerate().find_map(|(i, fault)| Some((i, fault?)));
    let Some((broken, mut fault)) = found else { return };
    let (mut tree, mut value) = (trees.swap_remove(broken), values[broken].clone());
    let mut simpler = tree.simplify();
    for _ in 0..500 {
        if !simpler {
            break;
        }
        let candidate = tree.current();
        simpler = match faults(std::slice::from_ref(&candidate)).pop().flatten() {
            Some(found) => {
                (fault, value) = (found, candidate);
                tree.simplify()
            }
            None => tree.complicate(),
        };
    }
    panic!("{law}: {value:?}: {fault}");
}

/// The largest number seen.
#[derive(Debug, Default)]
pub struct Worst(Cell<f64>);

impl Worst {
    pub fn see(&self, error: f64) -> f64 {
        self.0.set(self.0.get().max(error));
        error
    }

    pub fn get(&self) -> f64 {
        self.0.get()
    }
}

/// A number of any order of magnitude between these powers of ten.
pub fn of_any_size(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low..high).prop_map(|exponent| 10f64.powf(exponent))
}
