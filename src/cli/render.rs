//! `render`: trace until done, interrupted or failed; whatever was finished is written.

use super::console;
use super::failure::Failure;
use super::kernels;
use super::progress::Progress;
use super::render_args::{Job, RenderArgs};
use super::signals;
use super::stats::{self, Report};
use super::stop::{State, Stop};
use qtracer::film::{WriteOptions, write_image};
use qtracer::{CancelToken, EngineKind, Image, RenderError, Renderer};
use std::path::PathBuf;
use std::time::{Duration, Instant};

pub fn run(args: RenderArgs) -> Result<(), Failure> {
    let job = args.validate()?;
    job.scene.warnings().iter().for_each(console::warning);
    if let Some(folder) = &job.dump_kernels {
        let written = kernels::dump(folder, &job.scene, &job.options)?;
        note(&job, written);
    }
    if let Some(threads) = job.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build_global()
            .map_err(|e| Failure::failed(format!("--threads {threads}: {e}")))?;
    }
    let start = Instant::now();
    let mut renderer =
        Renderer::new(&job.scene, job.options.clone()).map_err(|e| Failure::of_start(&e))?;
    let preparation = start.elapsed();
    renderer.notices().iter().for_each(|text| note(&job, text));
    warn_of_idle_options(&job, renderer.engine());
    let cancel = renderer.cancel_token();
    signals::cancel_on_interrupt(cancel.clone());
    let (end, elapsed) = trace(&mut renderer, &job, &cancel);
    conclude(&job, &renderer, end, preparation, elapsed)
}

fn note(job: &Job, text: impl std::fmt::Display) {
    if !job.quiet {
        console::note(text);
    }
}

/// Options that only some engines have.
fn warn_of_idle_options(job: &Job, engine: EngineKind) {
    let options = &job.options;
    let wavefront = engine == EngineKind::Wavefront;
    let idle = [
        ("--schedule", options.schedule.is_some() && !wavefront),
        ("--pool", options.pool.is_some() && !wavefront),
        (
            "--adapter",
            options.adapter.is_some() && engine == EngineKind::Cpu,
        ),
    ];
    for (option, _) in idle.iter().filter(|(_, idle)| *idle) {
        console::warning(format!("{option} has no effect on the {engine} engine"));
    }
}

/// How tracing came to an end.
enum End {
    Done,
    Interrupted,
    Broken(RenderError),
}

/// Renders until the goal is reached, someone interrupts or something breaks; tells how long it took.
fn trace(renderer: &mut Renderer, job: &Job, cancel: &CancelToken) -> (End, Duration) {
    let film = renderer.film();
    let progress = Progress::new(film.pixels().len() as u64, job.quiet);
    let start = Instant::now();
    let end = loop {
        let state = state(renderer, &job.stop, start.elapsed());
        progress.show(&job.stop, &state);
        match job.stop.next(&state) {
            0 => break End::Done,
            samples => match renderer.step(samples) {
                Err(error) => break End::Broken(error),
                Ok(_) if cancel.is_cancelled() => break End::Interrupted,
                Ok(_) => (),
            },
        }
    };
    progress.finish();
    (end, start.elapsed())
}

fn state(renderer: &Renderer, stop: &Stop, elapsed: Duration) -> State {
    State {
        samples: renderer.samples(),
        elapsed,
        relative_error: match stop.needs_error() {
            true => renderer.film().relative_error(),
            false => f64::INFINITY,
        },
    }
}

/// Writes what there is and says what it is.
fn conclude(
    job: &Job,
    renderer: &Renderer,
    end: End,
    preparation: Duration,
    elapsed: Duration,
) -> Result<(), Failure> {
    let (fewest, most) = renderer.film().samples();
    // An interrupt during the last step may come too late to matter.
    let complete = match end {
        End::Interrupted => fewest >= u64::from(job.stop.max_samples),
        End::Done => true,
        End::Broken(_) => false,
    };
    let mut problems = match end {
        _ if complete => Vec::new(),
        End::Broken(error) => vec![error.to_string()],
        _ => vec!["interrupted".to_string()],
    };
    if fewest == 0 {
        problems.push("no sample of every pixel was finished, so nothing was written".to_string());
        return Err(Failure::failed_all(problems));
    }
    let written = write_outputs(job, renderer, &mut problems);
    if !complete && !written.is_empty() {
        problems.push(format!(
            "the image written has {} samples per pixel{}",
            range(fewest, most),
            wanted(&job.stop)
        ));
    }
    let report = Report::new(job, renderer, complete, preparation, elapsed);
    warn_of_noise(job, renderer, complete, elapsed);
    if !job.quiet {
        console::line(report.summary(&written));
    }
    if let Some(format) = job.stats {
        stats::print(&report, format)?;
    }
    match problems.is_empty() {
        true => Ok(()),
        false => Err(Failure::failed_all(problems)),
    }
}

/// `12`, or `12 to 13` where an interrupt left some pixels ahead of others.
fn range(fewest: u64, most: u64) -> String {
    match fewest == most {
        true => fewest.to_string(),
        false => format!("{fewest} to {most}"),
    }
}

fn wanted(stop: &Stop) -> String {
    match stop.goal {
        super::stop::Goal::Samples => format!(" of {}", stop.max_samples),
        _ => String::new(),
    }
}

/// Writes every output; one that can't be written does not keep the others from being so.
fn write_outputs<'a>(
    job: &'a Job,
    renderer: &Renderer,
    problems: &mut Vec<String>,
) -> Vec<&'a PathBuf> {
    let options = WriteOptions {
        exposure: job.exposure,
    };
    let image = finished_image(job, renderer);
    let mut written = Vec::new();
    for path in &job.outputs {
        match write_image(path, &image, &options) {
            Ok(()) => written.push(path),
            Err(error) => problems.push(error.to_string()),
        }
    }
    written
}

fn finished_image(job: &Job, renderer: &Renderer) -> Image {
    let mut image = match job.features {
        true => renderer.image_with_features(),
        false => renderer.image(),
    };
    let levels = job
        .options
        .max_bounces
        .unwrap_or(job.scene.defaults.max_bounces);
    // The only option that changes what a render converges to, so merging asks for it.
    image.metadata.set("max_bounces", levels);
    image
}

fn warn_of_noise(job: &Job, renderer: &Renderer, complete: bool, elapsed: Duration) {
    let state = state(renderer, &job.stop, elapsed);
    if complete && job.stop.fell_short(&state) {
        console::warning(format!(
            "stopped at {} samples per pixel before --error was reached; raise --max-spp",
            state.samples
        ));
    }
}
