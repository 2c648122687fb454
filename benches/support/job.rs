//! A job is one scene rendered in one way with several seeds, in a process of its own: what one job leaves behind can't slow
//! down the next.

use super::engines::Way;
use super::machine;
use super::measure::{Checks, Reached, render};
use super::rows::Row;
use super::truth::{self, Noise, Reference};
use super::variant::Variant;
use qtracer::film::read_image;
use qtracer::guiding::GuideOptions;
use qtracer::{Image, RenderOptions, Renderer, Sampler, Scene};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What is the same for all jobs of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Settings {
    pub first_seed: u32,
    pub seeds: u32,
    pub checks: Checks,
    pub epsilon: f64,
    /// Levels of a path; the scene's own if none.
    pub max_bounces: Option<u32>,
    pub independent: bool,
    pub adapter: Option<String>,
    pub mixture: Option<f32>,
    pub depth: Option<u32>,
    pub learning: Option<u32>,
    pub cell: Option<f32>,
    pub commit: String,
}

impl Settings {
    /// A guide with the numbers that were asked for.
    pub fn guide(&self, guide: GuideOptions) -> GuideOptions {
        GuideOptions {
            mixture: self.mixture.unwrap_or(guide.mixture),
            depth: self.depth.unwrap_or(guide.depth),
            learning_samples: self.learning.or(guide.learning_samples),
            cell_size: self.cell.or(guide.cell_size),
            ..guide
        }
    }
}

/// What the errors of a job are measured against.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Against {
    /// A converged image, and whether this program made it.
    Reference { path: PathBuf, self_made: bool },
    /// The other seeds, by squares relative to this image.
    Seeds { scale: PathBuf },
}

/// What a job is to do.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Task {
    /// Rows to stdout.
    Measure(Against),
    /// An image of the mean of all seeds at the last check point, with its standard error if there are several.
    Image(PathBuf),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    pub scene: String,
    pub size: (u32, u32),
    pub engine: String,
    pub variant: String,
    pub direct_light: bool,
    pub settings: Settings,
    pub task: Task,
}

/// What the renders of a job ran on.
struct Machine {
    /// The job's engine; where that is `auto`, which it took as well.
    engine: String,
    device: String,
    driver: String,
}

/// One seed: seconds before the first sample, and what was seen at each check point.
struct Run {
    setup_seconds: f64,
    reached: Vec<Reached>,
}

impl Job {
    /// Does what it says; rows go to `emit`, as soon as they are known.
    pub fn run(&self, emit: impl FnMut(Row)) -> Result<(), String> {
        let scene = Scene::load(&self.scene).map_err(|error| error.to_string())?;
        let machine = self.warm_up(&scene)?;
        match &self.task {
            Task::Measure(Against::Reference { path, self_made }) => {
                let reference = Reference::read(path, Some(self.size))?;
                self.against_reference(&scene, &machine, (&reference, *self_made), emit)
            }
            Task::Measure(Against::Seeds { scale }) => {
                let scale = read_image(scale).map_err(|error| error.to_string())?;
                self.against_each_other(&scene, &machine, &scale, emit)
            }
            Task::Image(path) => self.make_image(&scene, path),
        }
    }

    fn against_reference(
        &self,
        scene: &Scene,
        machine: &Machine,
        (reference, self_made): (&Reference, bool),
        mut emit: impl FnMut(Row),
    ) -> Result<(), String> {
        let epsilon = self.settings.epsilon;
        let kind = if self_made { "self-made" } else { "independent" };
        for seed in self.seeds() {
            let mut row = self.row(scene, machine, seed);
            row.truth = format!("{kind} reference {}", reference.name);
            row.truth_noise = reference.noise(epsilon);
            let run = self.render(scene, seed)?;
            for (check, reached) in run.reached.iter().enumerate() {
                let noise = reference.error_of(&reached.rgb, epsilon)?;
                emit(filled(&row, self.goal(check), run.setup_seconds, reached, noise));
            }
        }
        Ok(())
    }

    fn against_each_other(
        &self,
        scene: &Scene,
        machine: &Machine,
        scale: &Image,
        mut emit: impl FnMut(Row),
    ) -> Result<(), String> {
        let mut runs = Vec::new();
        for seed in self.seeds() {
            let mut row = self.row(scene, machine, seed);
            row.truth = "scatter between seeds".to_string();
            let run = self.render(scene, seed)?;
            runs.push((row, run));
        }
        for check in 0..self.settings.checks.len() {
            let images: Vec<Vec<[f32; 3]>> =
                runs.iter_mut().map(|(_, run)| std::mem::take(&mut run.reached[check].rgb)).collect();
            let noise = truth::scatter(&images, &scale.rgb, self.settings.epsilon)?;
            for ((row, run), noise) in runs.iter().zip(noise) {
                emit(filled(row, self.goal(check), run.setup_seconds, &run.reached[check], noise));
            }
        }
        Ok(())
    }

    fn make_image(&self, scene: &Scene, path: &Path) -> Result<(), String> {
        let mut images = Vec::new();
        for seed in self.seeds() {
            let run = self.render(scene, seed)?;
            let rgb = run.reached.into_iter().last().map(|reached| reached.rgb).unwrap_or_default();
            images.push(Image::new(self.size.0, self.size.1, rgb));
        }
        let image = if images.len() > 1 { truth::self_made(&images) } else { images.remove(0) };
        truth::write(path, &image)
    }

    fn seeds(&self) -> std::ops::Range<u32> {
        self.settings.first_seed..self.settings.first_seed + self.settings.seeds
    }

    fn goal(&self, check: usize) -> String {
        self.settings.checks.goal(check)
    }

    /// Threads, driver and caches are awake before the first clock starts.
    fn warm_up(&self, scene: &Scene) -> Result<Machine, String> {
        let mut renderer = Renderer::new(scene, self.options(0)?).map_err(|error| error.to_string())?;
        renderer.step(1).map_err(|error| error.to_string())?;
        let engine = match self.engine.as_str() {
            "auto" => format!("auto ({})", renderer.engine()),
            other => other.to_string(),
        };
        let (device, driver) = machine::device_and_driver(&renderer.device());
        Ok(Machine { engine, device, driver })
    }

    fn render(&self, scene: &Scene, seed: u32) -> Result<Run, String> {
        let options = self.options(seed)?;
        let start = Instant::now();
        let mut renderer = Renderer::new(scene, options).map_err(|error| error.to_string())?;
        let setup_seconds = start.elapsed().as_secs_f64();
        let mut reached = Vec::new();
        render(&mut renderer, &self.settings.checks, |point| reached.push(point))
            .map_err(|error| error.to_string())?;
        Ok(Run { setup_seconds, reached })
    }

    /// The options of one render.
    pub fn options(&self, seed: u32) -> Result<RenderOptions, String> {
        let settings = &self.settings;
        let mut options = RenderOptions {
            size: Some(self.size),
            seed,
            adapter: settings.adapter.clone(),
            direct_light: Some(self.direct_light),
            max_bounces: settings.max_bounces,
            sampler: if settings.independent { Sampler::Independent } else { Sampler::Stratified },
            budget: settings.checks.budget(),
            ..Default::default()
        };
        Way::named(&self.engine)?.apply(&mut options);
        self.variant.parse::<Variant>()?.apply(&mut options);
        options.guide = settings.guide(options.guide);
        Ok(options)
    }

    /// What is known of the rows of a seed before it is rendered.
    fn row(&self, scene: &Scene, machine: &Machine, seed: u32) -> Row {
        Row {
            scene: scene.name.clone(),
            renderer: "qtracer".to_string(),
            engine: machine.engine.clone(),
            variant: self.variant.clone(),
            direct_light: self.direct_light,
            max_bounces: self.settings.max_bounces.unwrap_or(scene.defaults.max_bounces),
            sampler: if self.settings.independent { "independent" } else { "stratified" }.to_string(),
            width: self.size.0,
            height: self.size.1,
            seed,
            epsilon: self.settings.epsilon,
            device: machine.device.clone(),
            driver: machine.driver.clone(),
            commit: self.settings.commit.clone(),
            date: machine::today(),
            ..Row::default()
        }
    }
}

/// A row of what was reached at a check point.
fn filled(row: &Row, goal: String, setup_seconds: f64, reached: &Reached, noise: Noise) -> Row {
    Row {
        goal,
        samples: reached.samples,
        seconds: reached.seconds,
        setup_seconds,
        relative_mse: Some(noise.plain),
        trimmed: Some(noise.trimmed),
        ..row.clone()
    }
}
