//! How much error is left after so many seconds or samples? benches/README.md says how to run it and how to read it.
//!
//! `cargo bench --bench speed_vs_error -- --engines fused,mega --variants off:throughput:4 auto --budget 4`

#[path = "support/mod.rs"]
#[allow(dead_code)] // Parts are for the tests.
mod support;

use clap::Parser;
use qtracer::Scene;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use support::arguments::Arguments;
use support::job::{Against, Job, Settings, Task};
use support::measure::Checks;
use support::page;
use support::rows::{self, Row, RowFile};
use support::summary::Estimate;
use support::truth::{self, Reference};

/// Seeds of what no error is measured of: far from those of renders.
const REFERENCE_SEED: u32 = 1_000_000;
const SCALE_SEED: u32 = 2_000_000;
/// How images are made that errors are measured against or relative to.
const PLAIN: &str = "off:throughput:4";
/// Renders that a self-made reference is the mean of.
const REFERENCE_PARTS: u32 = 16;

/// Why a run ends early.
enum Fault {
    /// What was asked for can't be done.
    Input(String),
    /// It failed on the way.
    Failed(String),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let outcome = match &arguments.worker {
        Some(job) => work(job),
        None => arguments.check().map_err(Fault::Input).and_then(|()| run(&arguments)),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(Fault::Input(message)) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
        Err(Fault::Failed(message)) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Does one job; rows go to stdout.
fn work(job: &str) -> Result<(), Fault> {
    let job: Job = serde_json::from_str(job).map_err(|error| Fault::Input(format!("--worker: {error}")))?;
    let print = |row: Row| println!("{}", serde_json::to_string(&row).unwrap_or_default());
    job.run(print).map_err(Fault::Failed)
}

/// Measures everything that was asked for, and reports.
fn run(arguments: &Arguments) -> Result<(), Fault> {
    let failed = |message| Fault::Failed(message);
    if !arguments.report.is_empty() {
        return report(arguments, &arguments.report).map_err(Fault::Input);
    }
    let settings = arguments.settings().map_err(Fault::Input)?;
    let scenes = arguments.scenes().into_iter().map(|path| Subject::new(arguments, path));
    let scenes: Vec<Subject> = scenes.collect::<Result<_, _>>().map_err(Fault::Input)?;
    let mut file = RowFile::append(&arguments.out.join("rows.jsonl")).map_err(failed)?;
    let ways = arguments.engines.len()
        * arguments.variants.len()
        * arguments.direct_lights().map_err(Fault::Input)?.len();
    let mut counter = Counter { done: 0, of: scenes.len() * ways, failures: 0 };
    for subject in &scenes {
        match subject.against(arguments, &settings) {
            Ok(against) => measure(arguments, &settings, subject, &against, &mut file, &mut counter)?,
            Err(message) => counter.fail(&subject.scene.name, &message),
        }
    }
    let reported = report(arguments, std::slice::from_ref(&arguments.out));
    match counter.failures {
        0 => reported.map_err(failed),
        count => Err(Fault::Failed(format!("{count} failed; what they said is above"))),
    }
}

/// Jobs done and failed, for people.
struct Counter {
    done: usize,
    of: usize,
    failures: usize,
}

impl Counter {
    fn fail(&mut self, what: &str, message: &str) {
        self.failures += 1;
        eprintln!("{what}: {message}");
    }
}

/// All ways to render one scene.
fn measure(
    arguments: &Arguments,
    settings: &Settings,
    subject: &Subject,
    against: &Against,
    file: &mut RowFile,
    counter: &mut Counter,
) -> Result<(), Fault> {
    for &direct_light in &arguments.direct_lights().map_err(Fault::Input)? {
        for variant in &arguments.variants {
            for engine in &arguments.engines {
                let task = Task::Measure(against.clone());
                let job = subject.job(engine, variant, direct_light, settings.clone(), task);
                counter.done += 1;
                let light = if direct_light { "" } else { ", no direct light" };
                let name = format!("{} {engine} {variant}{light}", subject.scene.name);
                eprint!("[{}/{}] {name}, {} seeds … ", counter.done, counter.of, settings.seeds);
                let last_goal = settings.checks.goal(settings.checks.len() - 1);
                let mut last = Vec::new();
                let outcome = spawn(&job, |row| {
                    file.write(&row)?;
                    last.extend(row.relative_mse.filter(|_| row.goal == last_goal));
                    Ok(())
                });
                match outcome {
                    Ok(()) => eprintln!("relMSE {}", in_words(&last)),
                    Err(message) => counter.fail(&name, &message),
                }
            }
        }
    }
    Ok(())
}

fn in_words(errors: &[f64]) -> String {
    let Estimate { mean, error } = Estimate::of(errors);
    format!("{mean:.3e} ± {error:.1e}")
}

/// Runs a job in a process of its own; its rows go to `take` as they come.
fn spawn(job: &Job, mut take: impl FnMut(Row) -> Result<(), String>) -> Result<(), String> {
    let text = |error: &dyn std::fmt::Display| error.to_string();
    let program = std::env::current_exe().map_err(|error| text(&error))?;
    let job = serde_json::to_string(job).map_err(|error| text(&error))?;
    let mut child = Command::new(program)
        .args(["--worker", &job])
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| text(&error))?;
    let rows = child.stdout.take().into_iter().flat_map(|out| BufReader::new(out).lines());
    for line in rows {
        let row = serde_json::from_str(&line.map_err(|error| text(&error))?).map_err(|error| text(&error))?;
        take(row)?;
    }
    let status = child.wait().map_err(|error| text(&error))?;
    if status.success() { Ok(()) } else { Err(format!("the job ended with {status}")) }
}

/// A scene to be rendered, and at what size.
struct Subject {
    path: String,
    scene: Scene,
    size: (u32, u32),
    /// A converged image that fits.
    reference: Option<PathBuf>,
}

impl Subject {
    /// Reads the scene and looks for its reference; refuses what does not fit together.
    fn new(arguments: &Arguments, path: String) -> Result<Subject, String> {
        let scene = Scene::load(&path).map_err(|error| error.to_string())?;
        let found =
            if arguments.no_reference { None } else { truth::find(&arguments.references, &scene.name) };
        let camera = (scene.camera.width, scene.camera.height);
        if found.is_none() && arguments.seeds == 1 && arguments.make_reference.is_none() {
            let name = &scene.name;
            return Err(format!("{name} has no reference: give at least 2 --seeds, or --make-reference SPP"));
        }
        let own = |reference| Subject { path, size: arguments.size().unwrap_or(camera), scene, reference };
        let Some(found) = found else { return Ok(own(None)) };
        match Reference::read(&found, arguments.size()) {
            Ok(reference) => {
                let size = (reference.image.width, reference.image.height);
                Ok(Subject { size, ..own(Some(found)) })
            }
            Err(_) if arguments.make_reference.is_some() => Ok(own(None)),
            Err(message) => {
                Err(format!("{message}; choose another --size, --no-reference or --make-reference SPP"))
            }
        }
    }

    fn job(&self, engine: &str, variant: &str, direct_light: bool, settings: Settings, task: Task) -> Job {
        let (scene, size) = (self.path.clone(), self.size);
        let (engine, variant) = (engine.to_string(), variant.to_string());
        Job { scene, size, engine, variant, direct_light, settings, task }
    }

    /// What errors are measured against; made first, if need be.
    fn against(&self, arguments: &Arguments, settings: &Settings) -> Result<Against, String> {
        if let Some(path) = &self.reference {
            if self.levels(settings) != 64 {
                eprintln!("note: references are of 64 levels, this is of {}", self.levels(settings));
            }
            return Ok(Against::Reference { path: path.clone(), self_made: false });
        }
        let engine = &arguments.engines[0];
        match arguments.make_reference {
            Some(samples) => {
                let path = self.beside_rows(arguments, settings, &format!("{samples}"))?;
                let checks = Checks::Samples(vec![samples.div_ceil(REFERENCE_PARTS)]);
                let settings = Settings {
                    first_seed: REFERENCE_SEED,
                    seeds: REFERENCE_PARTS,
                    checks,
                    ..settings.clone()
                };
                let task = Task::Image(path.clone());
                self.make(&path, &self.job(engine, PLAIN, true, settings, task))?;
                Ok(Against::Reference { path, self_made: true })
            }
            None => {
                let scale = self.beside_rows(arguments, settings, "scale")?;
                let checks = match settings.checks.clone() {
                    Checks::Seconds(seconds) => {
                        Checks::Seconds(seconds.last().map(|s| 2.0 * s).into_iter().collect())
                    }
                    Checks::Samples(samples) => {
                        Checks::Samples(samples.last().map(|s| 2 * s).into_iter().collect())
                    }
                };
                let settings = Settings { first_seed: SCALE_SEED, seeds: 1, checks, ..settings.clone() };
                let task = Task::Image(scale.clone());
                self.make(&scale, &self.job(engine, PLAIN, true, settings, task))?;
                Ok(Against::Seeds { scale })
            }
        }
    }

    fn levels(&self, settings: &Settings) -> u32 {
        settings.max_bounces.unwrap_or(self.scene.defaults.max_bounces)
    }

    /// Where an image that was made for a run is kept, for later runs.
    fn beside_rows(&self, arguments: &Arguments, settings: &Settings, kind: &str) -> Result<PathBuf, String> {
        let folder = arguments.out.join("references");
        std::fs::create_dir_all(&folder)
            .map_err(|error| format!("can't make {}: {error}", folder.display()))?;
        let (width, height) = self.size;
        let levels = self.levels(settings);
        Ok(folder.join(format!("{}-{width}x{height}-{levels}-{kind}.exr", self.scene.name)))
    }

    /// Renders an image unless an earlier run did.
    fn make(&self, path: &Path, job: &Job) -> Result<(), String> {
        if path.exists() {
            return Ok(());
        }
        eprintln!("making {}", path.display());
        spawn(job, |_| Ok(()))
    }
}

/// Writes rows.csv, summary.md and report.html from the rows of files and folders.
fn report(arguments: &Arguments, sources: &[PathBuf]) -> Result<(), String> {
    let mut files = Vec::new();
    for source in sources {
        files.extend(row_files(source)?);
    }
    let rows = rows::read(&files)?;
    if rows.is_empty() {
        return Err("there are no rows to report".to_string());
    }
    std::fs::create_dir_all(&arguments.out).map_err(|error| error.to_string())?;
    let summary = page::markdown(&arguments.title, &rows);
    let texts = [
        ("rows.csv", rows::csv(&rows)),
        ("report.html", page::html(&arguments.title, &rows)),
        ("summary.md", summary.clone()),
    ];
    for (name, text) in texts {
        let path = arguments.out.join(name);
        std::fs::write(&path, text).map_err(|error| format!("can't write {}: {error}", path.display()))?;
    }
    println!("{summary}");
    eprintln!(
        "{} rows; wrote rows.csv, summary.md and report.html to {}",
        rows.len(),
        arguments.out.display()
    );
    Ok(())
}

/// A file, or all row files of a folder.
fn row_files(source: &Path) -> Result<Vec<String>, String> {
    let fault = |error| format!("can't read {}: {error}", source.display());
    if !source.is_dir() {
        return Ok(vec![source.to_string_lossy().into_owned()]);
    }
    let entries = std::fs::read_dir(source).map_err(fault)?;
    let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files: Vec<String> = paths
        .filter(|path| path.extension().is_some_and(|extension| extension == "jsonl"))
        .map(|path| path.to_string_lossy().into_owned())
        .collect();
    files.sort();
    Ok(files)
}
