//! `render`: its raw arguments and the job that they make, checked before anything is rendered.

use super::console;
use super::failure::Failure;
use super::guide_args::{GuideArgs, GuideJob};
use super::stop::{Goal, Stop};
use super::values::{self, Switch};
use super::waiting;
use clap::{Args, ValueEnum};
use qtracer::film::check_writable;
use qtracer::gpu::stage::Schedule;
use qtracer::scene::Instancing;
use qtracer::transport::roulette::Roulette;
use qtracer::{EngineChoice, RenderOptions, Sampler, Scene};
use std::path::{Path, PathBuf};
use std::time::Duration;

#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct RenderArgs {
    /// Scene file (.toml or .json), or a model to be seen by itself (.glb, .gltf, .ply or .obj)
    scene: PathBuf,

    /// See a model by its camera of this name [default: its first, else one that sees all of it]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,

    /// Image to write: .png (to look at) or .exr (exact values, standard errors, features); may be given several
    /// times [default: the scene's file name with .png, in this folder]
    #[arg(short, long, value_name = "FILE")]
    output: Vec<PathBuf>,

    /// Width and height in pixels [default: the scene's]
    #[arg(long, value_name = "WxH", value_parser = values::size, allow_hyphen_values = true)]
    size: Option<(u32, u32)>,

    /// Print figures about the render to stdout when it is done
    #[arg(long, value_enum, value_name = "FORMAT", num_args = 0..=1, default_missing_value = "json")]
    stats: Option<StatsFormat>,

    /// Print only warnings and errors
    #[arg(short, long)]
    quiet: bool,

    #[command(flatten, next_help_heading = "How long")]
    stop: StopArgs,
    #[command(flatten, next_help_heading = "What to compute")]
    transport: TransportArgs,
    #[command(flatten, next_help_heading = "What to learn")]
    guide: GuideArgs,
    #[command(flatten, next_help_heading = "Where to compute")]
    engine: EngineArgs,
    #[command(flatten, next_help_heading = "Images")]
    images: ImageArgs,
}

#[derive(Args)]
struct StopArgs {
    /// Samples per pixel [default: the scene's]
    #[arg(long, value_name = "N", value_parser = values::count, allow_negative_numbers = true, group = "goal")]
    spp: Option<u32>,

    /// Render for this long: 90s, 2m, 1m30s, 1.5h
    #[arg(long, value_name = "TIME", value_parser = values::duration, allow_hyphen_values = true, group = "goal")]
    time: Option<Duration>,

    /// Render until the image's relative standard error is this or less: 0.01 is one per cent
    #[arg(long, value_name = "REL", value_parser = values::positive, allow_negative_numbers = true, group = "goal")]
    error: Option<f64>,

    /// With --time or --error: stop at this many samples per pixel at the latest [default: 65536 with --error]
    #[arg(long, value_name = "N", value_parser = values::count, allow_negative_numbers = true, conflicts_with = "spp")]
    max_spp: Option<u32>,
}

#[derive(Args)]
struct TransportArgs {
    /// Seed of the random numbers: equal seeds give equal images
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    seed: u32,

    /// Number of the first sample of each pixel, to render a later part of an image; see `qtracer merge`
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    first_sample: u32,

    /// Levels of a path: 1 shows only what emits, 2 adds direct light [default: the scene's]
    #[arg(long, value_name = "1..64", value_parser = clap::value_parser!(u32).range(1..=64), allow_negative_numbers = true)]
    max_bounces: Option<u32>,

    /// Sample lights directly at each surface [default: the scene's]
    #[arg(long, value_enum, value_name = "on|off", hide_possible_values = true)]
    direct_light: Option<Switch>,

    /// Where a scene has many lights, choose among them by a tree rather than by power alone [default: on]
    #[arg(long, value_enum, value_name = "on|off", hide_possible_values = true)]
    light_tree: Option<Switch>,

    /// End faint paths early, without bias: by their throughput, or by what their surroundings have learnt, which is
    /// believed from 64 samples on [default: the scene's; learnt with a guide]
    #[arg(long, value_enum, value_name = "off|throughput|learnt", hide_possible_values = true)]
    roulette: Option<RouletteArg>,

    /// Let this many times as many paths survive roulette: slower, less noisy
    /// [default: 1; learnt roulette and --guide auto: 4]
    #[arg(long, value_name = "X", value_parser = values::factor, allow_negative_numbers = true)]
    roulette_scale: Option<f32>,

    /// With --roulette learnt, from 64 samples on: let a path that is worth more than others go on as up to this many
    /// copies [default: 1]
    #[arg(long, value_name = "1..8", value_parser = clap::value_parser!(u32).range(1..=8), allow_negative_numbers = true)]
    split: Option<u32>,

    /// How the samples of a pixel relate: spread evenly, or independent, whose standard errors are exact
    #[arg(long, value_enum, default_value_t = SamplerArg::Stratified)]
    sampler: SamplerArg,
}

#[derive(Args)]
struct EngineArgs {
    /// auto takes a real GPU where there is one, else the CPU; all engines give the same image, guided ones
    /// to within noise
    #[arg(long, value_enum, default_value_t = EngineArg::Auto)]
    engine: EngineArg,

    /// Use the GPU whose name contains this; `qtracer info` lists them
    #[arg(long, value_name = "NAME", value_parser = values::adapter)]
    adapter: Option<String>,

    /// Threads of the CPU [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), allow_negative_numbers = true)]
    threads: Option<u16>,

    /// Store meshes that stand in many places once (shared), or give each instance triangles of its own (laid-out), which
    /// takes more memory; auto shares where that spares more than 32 MiB. Lamps, and what repeats fewer than 16384 triangles, are
    /// never shared. Renders of the two look alike, but are not merged with each other
    #[arg(long, value_enum, default_value_t = InstancesArg::Auto)]
    instances: InstancesArg,

    /// How the wavefront engine runs a level [default: what measured fastest: streamed for meshes of three kinds of
    /// materials or more, unless a guide is asked for (auto only tries it) or --grain is given; else fused]
    #[arg(long, value_enum)]
    schedule: Option<ScheduleArg>,

    /// Rays that the queues of the wavefront engine hold [default: what suits the GPU]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=1 << 26), allow_negative_numbers = true)]
    pool: Option<u32>,

    /// Levels of a path that the fused schedule traces at once (the sorted: at most), or paths that an invocation of the
    /// megakernel traces [default: by the lengths of paths]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64), allow_negative_numbers = true)]
    grain: Option<u32>,

    /// Also write the linked WGSL of each of the scene's kernels into this folder; needs no GPU
    #[arg(long, value_name = "DIR")]
    dump_kernels: Option<PathBuf>,
}

#[derive(Args)]
struct ImageArgs {
    /// Brighten .png images by this many powers of two; .exr images keep radiance as it is
    #[arg(long, value_name = "STOPS", default_value = "0", value_parser = values::stops, allow_negative_numbers = true)]
    exposure: f32,

    /// Add albedo, normal and depth of what is seen first to .exr images [default]
    #[arg(long, overrides_with = "no_features")]
    features: bool,

    /// Leave them out
    #[arg(long)]
    no_features: bool,
}

const EXAMPLES: &str = "\
Examples:
  qtracer render scenes/cornell-box.toml
      The scene's own settings, to cornell-box.png.
  qtracer render scenes/door-ajar.toml --spp 1024 -o door.exr -o door.png --exposure 1
      One render, two files; the picture one stop brighter.
  qtracer render model.glb --camera top --size 1280x720
      A model by itself, seen by one of its own cameras.
  qtracer render scenes/glass-caustic.toml --error 0.02 --max-spp 4096 --size 640x480
      Until the noise is 2 %, but no more than 4096 samples per pixel.
  qtracer render scenes/cornell-box.toml --time 2m --engine wavefront --stats json > stats.json
      Two minutes on the GPU; figures to a file.
  qtracer render room.toml --spp 512 -o a.exr
  qtracer render room.toml --spp 512 --first-sample 512 -o b.exr
  qtracer merge a.exr b.exr -o room.exr
      1024 samples in two parts, maybe on two machines.
  qtracer render scenes/door-ajar.toml --guide adaptive --spp 512 --save-guide door.guide
  qtracer render scenes/door-ajar.toml --guide adaptive --spp 512 --load-guide door.guide --seed 2
      Paths learn where light comes from; the second render starts with what the first has learnt.
  qtracer render scenes/door-ajar.toml --guide adaptive --show direction -o direction.png
      A picture of what was learnt.

Ctrl-C writes the image so far (without features) and exits 1; a second one exits at once.";

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StatsFormat {
    Json,
    Text,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SamplerArg {
    Stratified,
    Independent,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum InstancesArg {
    Auto,
    Shared,
    LaidOut,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RouletteArg {
    #[value(alias = "false")]
    Off,
    #[value(aliases = ["on", "true"])]
    Throughput,
    Learnt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum EngineArg {
    Auto,
    Cpu,
    Wavefront,
    Megakernel,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ScheduleArg {
    Compacted,
    Streamed,
    Fused,
    Sorted,
}

/// A render that has been checked as far as can be without rendering.
pub struct Job {
    pub scene: Scene,
    pub options: RenderOptions,
    /// What to do with what was learnt.
    pub guide: GuideJob,
    pub stop: Stop,
    pub outputs: Vec<PathBuf>,
    pub exposure: f32,
    /// Whether to compute albedo, normal and depth.
    pub features: bool,
    pub stats: Option<StatsFormat>,
    pub dump_kernels: Option<PathBuf>,
    pub quiet: bool,
}

/// A ceiling for --error, which a black image never reaches.
const MAX_SPP_WITH_ERROR: u32 = 65_536;

/// Samples per pixel below which there is too little to be learnt for a guide to be tried unasked.
const FEWEST_TO_GUIDE: u32 = 256;

impl TransportArgs {
    /// Whether anything is said of how paths end: it is to be so for all of them then, and a guide's trial would change it.
    fn says_roulette(&self) -> bool {
        self.roulette.is_some() || self.roulette_scale.is_some() || self.split.is_some()
    }
}

impl RenderArgs {
    /// How many threads to run on, if not on all.
    pub fn threads(&self) -> Option<usize> {
        self.engine.threads.map(usize::from)
    }

    /// Loads the scene and checks everything that can be wrong.
    pub fn validate(self) -> Result<Job, Failure> {
        let reading = format!("reading {}", self.scene.display());
        let load = || match &self.camera {
            Some(camera) => Scene::load_with_camera(&self.scene, camera),
            None => Scene::load(&self.scene),
        };
        let scene = waiting::during(&reading, self.quiet, load).map_err(Failure::bad_input)?;
        let stop = self.stop.validate(&scene, self.transport.first_sample)?;
        let outputs = match self.output.is_empty() {
            true => vec![default_output(&self.scene)],
            false => self.output,
        };
        check_outputs(&outputs)?;
        let has = |extension: &str| outputs.iter().any(|path| has_extension(path, extension));
        if self.images.exposure != 0.0 && !has("png") {
            console::warning("--exposure has no effect: no output is a .png");
        }
        if self.images.features && !has("exr") {
            console::warning("--features has no effect: no output is an .exr");
        }
        let tried =
            stop.max_samples >= FEWEST_TO_GUIDE && scene.defaults.roulette && !self.transport.says_roulette();
        let mut options = render_options(self.size, &self.transport, &self.guide, tried, &self.engine);
        options.budget = stop.budget();
        let estimators = options.estimators(&scene);
        let guide = self.guide.check(&estimators, &outputs)?;
        options.guide_table = self.guide.loaded(&estimators)?;
        if estimators.split > 1 && estimators.roulette != Roulette::Learnt {
            let problem = "--split goes with learnt roulette; add --roulette learnt, or --guide adaptive";
            return Err(Failure::bad_input(problem));
        }
        if options.roulette_scale.is_some() && estimators.roulette == Roulette::Off {
            console::warning("--roulette-scale has no effect: roulette is off");
        }
        let mature = options.guide.mature_samples;
        let asked = self.transport.split.is_some_and(|n| n > 1) || options.roulette == Some(Roulette::Learnt);
        if asked && stop.max_samples <= mature && options.guide_table.is_none() {
            console::warning(format!(
                "learnt roulette is believed from {mature} samples on, and there are to be {}; choose a larger --spp, or \
                 --load-guide",
                stop.max_samples
            ));
        }
        let shown = guide.layers && (has("exr") || guide.show.is_some());
        if guide.layers && !shown {
            console::warning("--guide-layers has no effect: no output is an .exr");
        }
        Ok(Job {
            features: has("exr") && !self.images.no_features,
            guide: GuideJob { layers: shown, ..guide },
            options,
            scene,
            stop,
            outputs,
            exposure: self.images.exposure,
            stats: self.stats,
            dump_kernels: self.engine.dump_kernels,
            quiet: self.quiet,
        })
    }
}

impl StopArgs {
    fn validate(&self, scene: &Scene, first_sample: u32) -> Result<Stop, Failure> {
        let last = u32::MAX - first_sample;
        let (goal, max_samples) = match (self.time, self.error) {
            (Some(limit), _) => (Goal::Time(limit), self.max_spp.unwrap_or(last)),
            (_, Some(limit)) => {
                let ceiling = self.max_spp.unwrap_or(MAX_SPP_WITH_ERROR.min(last));
                (Goal::Error(limit), ceiling)
            }
            (None, None) if self.max_spp.is_some() => {
                let problem = "--max-spp goes with --time or --error; for a fixed number use --spp";
                return Err(Failure::bad_input(problem));
            }
            (None, None) => (Goal::Samples, self.spp.unwrap_or(scene.defaults.spp)),
        };
        if max_samples > last || max_samples == 0 {
            return Err(Failure::bad_input(format!(
                "--first-sample {first_sample} and {max_samples} samples go beyond the last sample, {}; \
                 start at a lower --first-sample",
                u32::MAX
            )));
        }
        Ok(Stop { goal, max_samples })
    }
}

fn render_options(
    size: Option<(u32, u32)>,
    transport: &TransportArgs,
    guide: &GuideArgs,
    tried: bool,
    engine: &EngineArgs,
) -> RenderOptions {
    RenderOptions {
        size,
        seed: transport.seed,
        first_sample: transport.first_sample,
        max_bounces: transport.max_bounces,
        direct_light: transport.direct_light.map(bool::from),
        light_tree: transport.light_tree.map(bool::from),
        roulette: transport.roulette.map(|roulette| match roulette {
            RouletteArg::Off => Roulette::Off,
            RouletteArg::Throughput => Roulette::Throughput,
            RouletteArg::Learnt => Roulette::Learnt,
        }),
        roulette_scale: transport.roulette_scale,
        split: transport.split,
        guide: guide.options(tried),
        budget: Default::default(),
        guide_table: None,
        sampler: match transport.sampler {
            SamplerArg::Stratified => Sampler::Stratified,
            SamplerArg::Independent => Sampler::Independent,
        },
        engine: match engine.engine {
            EngineArg::Auto => EngineChoice::Auto,
            EngineArg::Cpu => EngineChoice::Cpu,
            EngineArg::Wavefront => EngineChoice::Wavefront,
            EngineArg::Megakernel => EngineChoice::Megakernel,
        },
        adapter: engine.adapter.clone(),
        schedule: engine.schedule.map(|schedule| match schedule {
            ScheduleArg::Compacted => Schedule::Compacted,
            ScheduleArg::Streamed => Schedule::Streamed,
            ScheduleArg::Fused => Schedule::Fused,
            ScheduleArg::Sorted => Schedule::Sorted,
        }),
        pool: engine.pool,
        grain: engine.grain,
        instances: match engine.instances {
            InstancesArg::Auto => Instancing::Auto,
            InstancesArg::Shared => Instancing::Shared,
            InstancesArg::LaidOut => Instancing::LaidOut,
        },
    }
}

/// The scene's file name with .png, in the current folder.
fn default_output(scene: &Path) -> PathBuf {
    let mut name = scene.file_stem().unwrap_or("image".as_ref()).to_owned();
    name.push(".png");
    PathBuf::from(name)
}

/// Every problem that can be known before hours of rendering.
fn check_outputs(outputs: &[PathBuf]) -> Result<(), Failure> {
    for (index, path) in outputs.iter().enumerate() {
        check_writable(path).map_err(Failure::bad_input)?;
        if outputs[..index].contains(path) {
            let path = path.display();
            return Err(Failure::bad_input(format!("-o \"{path}\" is given twice; leave one out")));
        }
    }
    Ok(())
}

pub fn has_extension(path: &Path, wanted: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(wanted))
}
