//! `render`: trace until done, interrupted or failed; whatever was finished is written.

use super::console;
use super::failure::Failure;
use super::kernels;
use super::progress::Progress;
use super::render_args::{Job, RenderArgs, has_extension};
use super::signals;
use super::stats::{self, Report};
use super::stop::{Goal, State};
use super::waiting;
use qtracer::engine::GuideView;
use qtracer::film::{WriteOptions, write_image};
use qtracer::guiding::GuideOptions;
use qtracer::{EngineKind, Image, RenderError, RenderOptions, RenderStats, Renderer, Scene};
use std::path::PathBuf;
use std::time::{Duration, Instant};

pub fn run(args: RenderArgs) -> Result<(), Failure> {
    // Before the scene is read: that runs on all threads already.
    limit_threads(args.threads())?;
    let job = args.validate()?;
    job.scene.warnings().iter().for_each(console::warning);
    if let Some(folder) = &job.dump_kernels {
        let written = kernels::dump(folder, &job.scene, &job.options)?;
        note(&job, written);
    }
    let slot = signals::watch();
    let start = Instant::now();
    let prepared = || renderer_of(&job);
    let (mut renderer, unguided) =
        waiting::during(&preparing(&job.scene), job.quiet, prepared).map_err(|e| Failure::of_start(&e))?;
    unguided.iter().for_each(|reason| note(&job, format!("no guide is tried: {reason}")));
    slot.get_or_init(|| renderer.cancel_token());
    let preparation = start.elapsed();
    renderer.notices().iter().for_each(|text| note(&job, text));
    warn_of_idle_options(&job, renderer.engine());
    warn_of_other_scene(&job, &renderer);
    let (end, elapsed) = trace(&mut renderer, &job);
    Ending::new(&job, &renderer, end, preparation, elapsed).conclude()
}

/// The renderer, and why it does without a guide that nobody had asked for, if there is none to be had.
fn renderer_of(job: &Job) -> Result<(Renderer, Option<RenderError>), RenderError> {
    let renderer = |options| Renderer::new(&job.scene, options);
    match renderer(job.options.clone()) {
        Err(reason) if job.guide.unasked && job.options.guide.trial => {
            let plain = RenderOptions { guide: GuideOptions::default(), ..job.options.clone() };
            // What is wrong without a guide, too, is told as what it is.
            renderer(plain).map(|renderer| (renderer, Some(reason)))
        }
        made => made.map(|renderer| (renderer, None)),
    }
}

fn limit_threads(threads: Option<usize>) -> Result<(), Failure> {
    let Some(threads) = threads else { return Ok(()) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build_global().map_err(|e| Failure::failed(format!("--threads {threads}: {e}")))
}

/// What happens before the first sample; what it costs is mostly the hierarchy over the triangles.
fn preparing(scene: &Scene) -> String {
    match scene.triangle_count() {
        0 => "preparing the scene".to_owned(),
        1 => "putting 1 triangle in order".to_owned(),
        count => format!("putting {count} triangles in order"),
    }
}

fn note(job: &Job, text: impl std::fmt::Display) {
    if !job.quiet {
        console::note(text);
    }
}

/// Options that only some engines have.
fn warn_of_idle_options(job: &Job, engine: EngineKind) {
    let options = &job.options;
    let (cpu, wavefront) = (engine == EngineKind::Cpu, engine == EngineKind::Wavefront);
    let idle = [
        ("--schedule", options.schedule.is_some() && !wavefront),
        ("--pool", options.pool.is_some() && !wavefront),
        ("--grain", options.grain.is_some() && cpu),
        ("--adapter", options.adapter.is_some() && cpu),
    ];
    for (option, _) in idle.iter().filter(|(_, idle)| *idle) {
        console::warning(format!("{option} has no effect on the {engine} engine"));
    }
}

/// A guide that was learnt elsewhere is no fault: it steers paths, and the image is right all the same.
fn warn_of_other_scene(job: &Job, renderer: &Renderer) {
    if let (Some(before), Some(now)) = (&job.options.guide_table, renderer.learner())
        && before.scene() != now.scene()
    {
        console::warning(
            "--load-guide: it was learnt in another scene; the image will be right, but maybe no less noisy",
        );
    }
}

/// How tracing came to an end.
enum End {
    Done,
    Interrupted,
    Broken(RenderError),
}

/// Renders until the goal is reached, someone interrupts or something breaks; tells how long it took.
fn trace(renderer: &mut Renderer, job: &Job) -> (End, Duration) {
    let progress = Progress::new(renderer.film().pixels().len() as u64, job.quiet);
    let start = Instant::now();
    let end = loop {
        let state = state(renderer, job, start.elapsed());
        progress.show(&job.stop, &state);
        match job.stop.next(&state) {
            0 => break End::Done,
            samples => match renderer.step(samples) {
                Err(RenderError::Cancelled) => break End::Interrupted,
                Err(error) => break End::Broken(error),
                Ok(_) => (),
            },
        }
    };
    progress.finish();
    (end, start.elapsed())
}

fn state(renderer: &Renderer, job: &Job, elapsed: Duration) -> State {
    State {
        samples: renderer.samples(),
        elapsed,
        relative_error: match job.stop.needs_error() {
            true => renderer.relative_error(),
            false => f64::INFINITY,
        },
    }
}

/// What there is when tracing has ended.
struct Ending<'a> {
    job: &'a Job,
    renderer: &'a Renderer,
    preparation: Duration,
    elapsed: Duration,
    /// Whether all that was asked for is there.
    complete: bool,
    /// What went wrong: reasons for exit code 1.
    problems: Vec<String>,
}

impl<'a> Ending<'a> {
    fn new(job: &'a Job, renderer: &'a Renderer, end: End, preparation: Duration, elapsed: Duration) -> Self {
        // An interrupt during the last step may come too late to matter.
        let all = renderer.film().samples().0 >= u64::from(job.stop.max_samples);
        let problem = match end {
            End::Broken(error) => Some(error.to_string()),
            End::Interrupted if !all => Some("interrupted".to_string()),
            _ => None,
        };
        Ending {
            job,
            renderer,
            preparation,
            elapsed,
            complete: problem.is_none(),
            problems: problem.into_iter().collect(),
        }
    }

    /// Writes what there is and says what it is.
    fn conclude(mut self) -> Result<(), Failure> {
        if self.renderer.film().samples().1 == 0 {
            let problem = "no sample was finished, so nothing was written";
            self.problems.push(problem.to_string());
            return Err(Failure::failed_all(self.problems));
        }
        let mut written = self.write_outputs();
        written.extend(self.save_guide());
        if !self.complete && !written.is_empty() {
            let problem = format!("the image written has {}", self.samples_so_far());
            self.problems.push(problem);
        }
        self.report(&written);
        match self.problems.is_empty() {
            true => Ok(()),
            false => Err(Failure::failed_all(self.problems)),
        }
    }

    /// Writes every output; one that can't be written does not keep the others from being so.
    fn write_outputs(&mut self) -> Vec<&'a PathBuf> {
        let options = WriteOptions { exposure: self.job.exposure };
        let image = self.image();
        let shown = self.job.guide.show.and_then(|view| shown(view, &image, options.exposure));
        let mut written = Vec::new();
        for path in &self.job.outputs {
            let result = match &shown {
                Some((picture, options)) if has_extension(path, "png") => write_image(path, picture, options),
                _ => write_image(path, &image, &options),
            };
            match result {
                Ok(()) => written.push(path),
                Err(error) => self.problems.push(error.to_string()),
            }
        }
        written
    }

    /// Writes what was learnt, if that is asked for; the file if it is there.
    fn save_guide(&mut self) -> Option<&'a PathBuf> {
        let (path, learner) = (self.job.guide.save.as_ref()?, self.renderer.learner()?);
        if learner.passes() == 0 {
            let path = path.display();
            console::warning(format!(
                "\"{path}\" knows nothing: render at least 2 samples per pixel to learn"
            ));
        }
        learner.save(path).map_err(|error| self.problems.push(error.to_string())).ok()?;
        Some(path)
    }

    /// Whoever interrupts wants no further rays: features are for complete renders.
    fn image(&self) -> Image {
        let image = match self.job.features && self.complete {
            true => self.renderer.image_with_features(),
            false => self.renderer.image(),
        };
        match self.job.guide.layers && (self.complete || self.job.guide.show.is_some()) {
            true => Image { guide: self.renderer.guide_layers(), ..image },
            false => image,
        }
    }

    /// `12 samples per pixel of 64`; `12 to 13` where an interrupt left some pixels ahead of others.
    fn samples_so_far(&self) -> String {
        let (fewest, most) = self.renderer.film().samples();
        let range = match fewest == most {
            true => fewest.to_string(),
            false => format!("{fewest} to {most}"),
        };
        match self.job.stop.goal {
            Goal::Samples => {
                let wanted = self.job.stop.max_samples;
                format!("{range} samples per pixel of {wanted}")
            }
            _ => format!("{range} samples per pixel"),
        }
    }

    /// Figures, to stderr for people and to stdout for programs.
    fn report(&mut self, written: &[&PathBuf]) {
        let state = state(self.renderer, self.job, self.elapsed);
        if self.complete && self.job.stop.fell_short(&state) {
            console::warning(format!(
                "stopped at {} samples per pixel before --error was reached; raise --max-spp",
                state.samples
            ));
        }
        let report = Report::new(self.job, self.renderer, self.complete, self.preparation, self.elapsed);
        lost_samples(&report.engine).iter().for_each(console::warning);
        if !self.job.quiet {
            console::line(report.summary(written));
        }
        if let Some(Err(failure)) = self.job.stats.map(|format| stats::print(&report, format)) {
            self.problems.extend(failure.into_messages());
        }
    }
}

/// What to say of samples that were no numbers, if there were any.
fn lost_samples(stats: &RenderStats) -> Option<String> {
    let (lost, all) = (stats.lost_samples, stats.paths);
    (lost > 0).then(|| {
        format!(
            "{lost} of {all} samples came out infinite, as no number or above 1e18; they count as black, so the image is too \
             dark where they fell. Lower colors above 1, raise a --roulette-scale below 1, and bring sizes and radiances \
             closer together; if they are ordinary ones, this is a fault of qtracer or of the driver: compare with --engine \
             cpu and report it"
        )
    })
}

/// The picture of what was learnt in place of the image. Only radiance can be exposed.
fn shown(view: GuideView, image: &Image, exposure: f32) -> Option<(Image, WriteOptions)> {
    let rgb = view.picture(image.guide.as_ref()?);
    let mut metadata = image.metadata.clone();
    metadata.set("show", view);
    let exposure = if view == GuideView::Illumination { exposure } else { 0.0 };
    Some((Image { metadata, ..Image::new(image.width, image.height, rgb) }, WriteOptions { exposure }))
}

#[cfg(test)]
mod tests {
    use super::super::guide_args::GuideJob;
    use super::super::stop::Stop;
    use super::*;
    use qtracer::film::read_image;
    use qtracer::gpu::error::GpuError;
    use qtracer::scene::Material;
    use qtracer::{RenderOptions, Scene};

    fn job(output: PathBuf) -> Job {
        let scene = Scene::builder("ball")
            .camera([0.0, 0.0, 4.0], [0.0; 3], 45.0)
            .size(4, 3)
            .environment([1.0; 3])
            .material("grey", Material::diffuse([0.5; 3]))
            .sphere([0.0; 3], 1.0, "grey")
            .build()
            .unwrap();
        Job {
            scene,
            options: RenderOptions::cpu(),
            guide: GuideJob::default(),
            stop: Stop { goal: Goal::Samples, max_samples: 8 },
            outputs: vec![output],
            exposure: 0.0,
            features: true,
            stats: None,
            dump_kernels: None,
            quiet: true,
        }
    }

    /// Ends a render with a lost device after `samples` samples; gives the messages.
    fn lose_the_device_after(samples: u32, job: &Job) -> Vec<String> {
        let mut renderer = Renderer::new(&job.scene, job.options.clone()).unwrap();
        while renderer.samples() < samples {
            renderer.step(samples - renderer.samples()).unwrap();
        }
        let lost = End::Broken(RenderError::Gpu(GpuError::DeviceLost {
            adapter: "GPU".into(),
            reason: "reset".into(),
        }));
        let ending = Ending::new(job, &renderer, lost, Duration::ZERO, Duration::ZERO);
        ending.conclude().unwrap_err().into_messages()
    }

    #[test]
    fn a_lost_device_ends_with_the_image_so_far_and_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let job = job(folder.path().join("out.exr"));
        let messages = lose_the_device_after(3, &job);
        assert!(messages[0].contains("was lost"), "{messages:?}");
        assert_eq!(messages[1], "the image written has 3 samples per pixel of 8");
        let image = read_image(&job.outputs[0]).unwrap();
        assert!(image.samples.unwrap().iter().all(|&count| count == 3.0));
    }

    /// NaN can't be written into a scene file; it is put in behind the validation.
    #[test]
    fn samples_that_are_no_numbers_are_told_of_once_and_by_number() {
        let folder = tempfile::tempdir().unwrap();
        let mut job = job(folder.path().join("out.exr"));
        let lost = |job: &Job| {
            let mut renderer = Renderer::new(&job.scene, job.options.clone()).unwrap();
            while renderer.samples() < 5 {
                renderer.step(5 - renderer.samples()).unwrap();
            }
            lost_samples(&renderer.stats())
        };
        assert_eq!(lost(&job), None);
        job.scene.environment.y = f64::NAN;
        let text = lost(&job).unwrap();
        assert!(text.starts_with("60 of 60 samples came out infinite, as no number or above 1e18"), "{text}");
    }

    #[test]
    fn a_device_lost_at_once_writes_nothing_and_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let job = job(folder.path().join("out.exr"));
        let messages = lose_the_device_after(0, &job);
        assert!(messages[1].contains("nothing was written"), "{messages:?}");
        assert!(!job.outputs[0].exists());
    }
}
