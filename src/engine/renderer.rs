//! The renderer: chooses an engine and fills a film, step by step.

use super::auto::preferred_engine;
use super::cpu::CpuEngine;
use super::features::features;
use super::gpu_film::Keys;
use super::guided::Guided;
use super::megakernel::MegakernelEngine;
use super::show::guide_layers;
use super::strategy::plain_strategy;
use super::wavefront::WavefrontEngine;
use super::{
    CancelToken, Engine, EngineChoice, EngineKind, EnvironmentStats, Estimators, GuideStats, HierarchyStats,
    InstanceStats, LightTreeStats, RenderError, RenderOptions, RenderStats, SurfaceStats,
};
use crate::film::{Film, GuideLayers, Image};
use crate::gpu::device::Gpu;
use crate::gpu::key::KernelKey;
use crate::guiding::{GuideMode, Learner};
use crate::scene::Scene;
use crate::scene::compiled::{CompiledScene, Uniforms};

/// Renders a scene progressively. Nothing is printed and nothing is global; it may be sent to another thread.
pub struct Renderer {
    engine: Box<dyn Engine>,
    film: Film,
    compiled: CompiledScene,
    uniforms: Uniforms,
    scene_name: String,
    first_sample: u32,
    samples: u32,
    cancel: CancelToken,
    notices: Vec<String>,
    /// Why no further step is possible.
    ended: Option<RenderError>,
    estimators: Estimators,
    guided: Option<Guided>,
}

impl Renderer {
    /// Prepares the scene for the engine that the options ask for, or the best there is.
    pub fn new(scene: &Scene, options: RenderOptions) -> Result<Renderer, RenderError> {
        options.validate(scene)?;
        let mut compiled = CompiledScene::with_instances(scene, options.instances);
        if options.light_tree == Some(false) {
            compiled.light_tree = None;
        }
        let (width, height) = options.size.unwrap_or((scene.camera.width, scene.camera.height));
        let mut uniforms = compiled.uniforms(&scene.camera, width, height, options.seed);
        let estimators = options.estimators(scene);
        uniforms.max_bounces = estimators.max_bounces;
        let mut notices = Vec::new();
        uniforms.roulette_scale = estimators.roulette_scale;
        let mut engine = build_engine(estimators, &options, &compiled, uniforms, &mut notices)?;
        let guided = Guided::start(&options, estimators, &compiled, &uniforms, engine.as_mut())?;
        Ok(Renderer {
            engine,
            film: Film::new(width, height),
            compiled,
            uniforms,
            scene_name: scene.name.clone(),
            first_sample: options.first_sample,
            samples: 0,
            cancel: CancelToken::default(),
            notices,
            ended: None,
            estimators,
            guided,
        })
    }

    /// Renders up to `samples` further samples of each pixel, fewer if that would take long; returns how many it did.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] once the token was used, else whatever failed; every later call returns the same.
    /// The image of what was done before is still there.
    pub fn step(&mut self, samples: u32) -> Result<u32, RenderError> {
        if let Some(error) = &self.ended {
            return Err(error.clone());
        }
        let first = self.first_sample.checked_add(self.samples);
        let Some((first, end)) = first.and_then(|f| Some((f, f.checked_add(samples)?))) else {
            let last = u64::from(self.first_sample) + u64::from(self.samples) + u64::from(samples);
            return Err(RenderError::TooManySamples { last });
        };
        let wanted = self.engine.step_samples().max(1);
        // Steps end at multiples of what the engine likes, so that their blocks of samples do not depend on the steps.
        let step_end = end.min((first / wanted).saturating_add(1).saturating_mul(wanted));
        let step_end = step_end.min(self.guided.as_ref().map_or(u32::MAX, Guided::end));
        let rendered = self.engine.render(first..step_end, &mut self.film, &self.cancel);
        let cancelled = || if self.cancel.is_cancelled() { Err(RenderError::Cancelled) } else { Ok(()) };
        if let Err(error) = rendered.and_then(|()| cancelled()) {
            // Part of the range may be in the film; going on would count it twice.
            self.samples = u32::try_from(self.film.samples().0).unwrap_or(u32::MAX);
            self.ended = Some(error.clone());
            return Err(error);
        }
        self.samples += step_end - first;
        if let Some(guided) = &mut self.guided
            && let Err(error) = guided.conclude_pass(self.samples, &self.film, self.engine.as_mut())
        {
            self.ended = Some(error.clone());
            return Err(error);
        }
        Ok(step_end - first)
    }

    /// Samples of each pixel finished so far.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// Sums so far; merge films of other sample ranges into one to put a distributed render together.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// Relative standard error of [`Renderer::image`], as [`Film::relative_error`] defines it: where passes are weighed, that of the
    /// sum by their weights.
    pub fn relative_error(&self) -> f64 {
        match &self.guided {
            Some(guided) => guided.relative_error(&self.film),
            None => self.film.relative_error(),
        }
    }

    /// The image so far with its standard errors; metadata says scene, seed, samples, engine and version.
    pub fn image(&self) -> Image {
        let mut image = self.film.image();
        if let Some(guided) = &self.guided {
            image = guided.combine(&self.film, image);
        }
        let metadata = &mut image.metadata;
        metadata.set("scene", &self.scene_name);
        metadata.set("seed", self.uniforms.seed);
        metadata.set("first_sample", self.first_sample);
        metadata.set("samples", self.film.samples().1);
        metadata.set("max_bounces", self.estimators.max_bounces);
        metadata.set("sampler", format!("{:?}", self.estimators.sampler).to_lowercase());
        metadata.set("direct_light", self.estimators.direct_light);
        let (guide, roulette) = match self.guided.as_ref().and_then(Guided::plain_so_far) {
            Some(roulette) => (GuideMode::Off, roulette),
            None => (self.estimators.guide, self.estimators.roulette),
        };
        metadata.set("roulette", roulette);
        if self.estimators.places() > 1 {
            metadata.set("split", self.estimators.places());
        }
        match self.learner().filter(|_| guide.is_biased()) {
            Some(learner) => {
                metadata.set("guide", format!("{guide} (biased)"));
                metadata.set("guide_rule", rule(learner));
            }
            None => metadata.set("guide", guide),
        }
        metadata.set("fingerprint", format!("{:016x}", self.compiled.fingerprint(&self.uniforms)));
        metadata.set("engine", self.engine.kind());
        metadata.set("device", self.engine.device());
        metadata.set("software", concat!("qtracer ", env!("CARGO_PKG_VERSION")));
        image
    }

    /// The image so far with first-hit albedo, normal and depth, which cost 16 further rays a pixel on the CPU.
    pub fn image_with_features(&self) -> Image {
        Image { features: Some(features(&self.compiled, &self.uniforms)), ..self.image() }
    }

    /// Cancels [`Renderer::step`] from another thread.
    pub fn cancel_token(&self) -> CancelToken {
        self.cancel.clone()
    }

    /// The engine that was chosen.
    pub fn engine(&self) -> EngineKind {
        self.engine.kind()
    }

    /// What it runs on.
    pub fn device(&self) -> String {
        self.engine.device()
    }

    /// Things a user should know about the choices made, such as falling back to the CPU.
    pub fn notices(&self) -> &[String] {
        &self.notices
    }

    pub fn stats(&self) -> RenderStats {
        RenderStats {
            guide: self.learner().map(GuideStats::new),
            hierarchy: HierarchyStats::new(&self.compiled),
            instances: InstanceStats::new(&self.compiled),
            surfaces: SurfaceStats::new(&self.compiled),
            environment_map: EnvironmentStats::new(&self.compiled),
            light_tree: LightTreeStats::new(&self.compiled),
            ..self.engine.stats()
        }
    }

    /// What was learnt in the passes that are finished; None if nothing is to be learnt.
    pub fn learner(&self) -> Option<&Learner> {
        self.guided.as_ref().map(Guided::learner)
    }

    /// What was learnt about the surfaces that the camera sees, which costs 16 further paths a pixel on the CPU; None if
    /// nothing is to be learnt.
    pub fn guide_layers(&self) -> Option<GuideLayers> {
        self.learner().map(|learner| guide_layers(&self.compiled, &self.uniforms, learner))
    }
}

/// What a biased guide's image depends on.
fn rule(learner: &Learner) -> String {
    let (options, cell) = (learner.options(), learner.cell_size());
    let alpha = options.alpha.map_or("default".to_string(), |alpha| alpha.to_string());
    let (discount, threshold) = (options.discount, options.threshold);
    format!("cell {cell}, alpha {alpha}, discount {discount}, threshold {threshold}")
}

fn build_engine(
    estimators: Estimators,
    options: &RenderOptions,
    compiled: &CompiledScene,
    uniforms: Uniforms,
    notices: &mut Vec<String>,
) -> Result<Box<dyn Engine>, RenderError> {
    let cpu = || {
        let engine = CpuEngine::new(compiled.clone(), uniforms, estimators);
        Ok(Box::new(engine) as Box<dyn Engine>)
    };
    let key = KernelKey::new(compiled, &estimators);
    let plain = plain_strategy(options, estimators).map(|plain| {
        let estimators = Estimators { guide: GuideMode::Off, roulette: plain.roulette, ..estimators };
        KernelKey::new(compiled, &estimators)
    });
    let keys = Keys { own: key, plain };
    let on_gpu = |gpu: Gpu, kind: EngineKind| -> Result<Box<dyn Engine>, RenderError> {
        Ok(match kind {
            EngineKind::Megakernel => {
                Box::new(MegakernelEngine::new(gpu, compiled, uniforms, keys, options)?)
            }
            _ => Box::new(WavefrontEngine::new(gpu, compiled, uniforms, keys, options)?),
        })
    };
    let adapter = options.adapter.as_deref();
    match options.engine {
        EngineChoice::Cpu => cpu(),
        EngineChoice::Megakernel => on_gpu(Gpu::open(adapter)?, EngineKind::Megakernel),
        EngineChoice::Wavefront => on_gpu(Gpu::open(adapter)?, EngineKind::Wavefront),
        EngineChoice::Auto => match Gpu::open(adapter) {
            Ok(gpu) if !gpu.summary.software || adapter.is_some() => {
                on_gpu(gpu, preferred_engine(compiled, &key, options))
            }
            Ok(gpu) => {
                let name = &gpu.summary.name;
                notices.push(format!("the only adapter is a software one ({name}): using the CPU engine"));
                cpu()
            }
            Err(_) if adapter.is_none() => {
                notices.push("no GPU found: using the CPU engine".to_string());
                cpu()
            }
            Err(error) => Err(error.into()),
        },
    }
}
