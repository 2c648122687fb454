//! What `speed_vs_error` can be asked, and what that asks of each scene.

use super::engines::Way;
use super::job::Settings;
use super::machine;
use super::measure::Checks;
use super::variant::Variant;
use clap::Parser;
use qtracer::guiding::GuideProblem;
use std::path::PathBuf;

/// How much error is left after so many seconds or samples? Rows, a table and a page of plots.
///
/// Each combination of scene, engine, variant and direct light is rendered with several seeds, each render looked at several
/// times on its way; learning is charged. Errors are relMSE against a converged image, minus that image's own, or without one
/// the scatter between seeds. Rows are appended to OUT/rows.jsonl one by one, and the report is of all OUT/*.jsonl.
#[derive(Parser, Debug)]
#[command(after_help = "Examples:
  speed_vs_error --engines fused,mega --variants off:throughput:4 auto --budget 4 --out results
  speed_vs_error --scenes scenes/door-ajar.toml --engines cpu --spp 16,64,256 --seeds 3
  speed_vs_error --report results peers.jsonl --out page     # the page again, with more rows")]
pub struct Arguments {
    /// Scene files; by default the five that have references.
    #[arg(long, alias = "scene", num_args = 1..)]
    pub scenes: Vec<String>,
    /// cpu, mega, fused, streamed, compacted, wavefront, auto.
    #[arg(long, alias = "engine", num_args = 1.., value_delimiter = ',', default_value = "auto")]
    pub engines: Vec<String>,
    /// GUIDE[:ROULETTE[:SCALE]], such as off:throughput:4, adaptive:learnt:3 or auto.
    #[arg(long, alias = "variant", num_args = 1.., value_delimiter = ',', default_values = ["off:throughput:4", "auto"])]
    pub variants: Vec<String>,
    /// on, off or both.
    #[arg(long, num_args = 1.., value_delimiter = ',', default_value = "on")]
    pub direct_light: Vec<String>,
    /// Renders of each combination; 30 are the most.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=30))]
    pub seeds: u32,
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..1_000_000))]
    pub first_seed: u32,
    /// Seconds of one render, looked at after 1/2, 1/4, … of them too.
    #[arg(long, default_value_t = 2.0, conflicts_with_all = ["seconds", "spp"])]
    pub budget: f64,
    /// How often a render of --budget is looked at.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub checks: u32,
    /// Check points in seconds, rising.
    #[arg(long, value_delimiter = ',', conflicts_with = "spp")]
    pub seconds: Vec<f64>,
    /// Check points in samples per pixel, rising.
    #[arg(long, value_delimiter = ',')]
    pub spp: Vec<u32>,
    /// Width and height; by default the reference's, or where there is none the scene's.
    #[arg(long, num_args = 2)]
    pub size: Option<Vec<u32>>,
    /// Converged images as SCENE.exr with standard errors in them or in SCENE.se.exr.
    #[arg(long, default_value = "tests/references")]
    pub references: PathBuf,
    /// Compares seeds with each other instead.
    #[arg(long, conflicts_with = "make_reference")]
    pub no_reference: bool,
    /// Where there is no reference, makes one of so many samples per pixel, by 16 seeds, without a guide.
    #[arg(long, value_name = "SPP", value_parser = clap::value_parser!(u32).range(16..))]
    pub make_reference: Option<u32>,
    /// Added to squares of the reference in relMSE.
    #[arg(long, default_value_t = 0.01)]
    pub epsilon: f64,
    /// Levels of a path, 1 to 64; by default the scene's. References are of 64.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub max_bounces: Option<u32>,
    /// Independent samples instead of stratified ones.
    #[arg(long)]
    pub independent: bool,
    /// Part of the GPU's name.
    #[arg(long)]
    pub adapter: Option<String>,
    /// Share of guided directions, 0 to 0.95.
    #[arg(long)]
    pub mixture: Option<f32>,
    /// Levels of quadtrees, 0 to 7.
    #[arg(long)]
    pub depth: Option<u32>,
    /// Samples per pixel that teach.
    #[arg(long)]
    pub learning: Option<u32>,
    /// Edge of a guide's base cell in scene units.
    #[arg(long)]
    pub cell: Option<f32>,
    /// What rows say the code is; by default what git says.
    #[arg(long)]
    pub commit: Option<String>,
    /// Folder of rows and report.
    #[arg(long, default_value = "target/speed_vs_error")]
    pub out: PathBuf,
    /// Measures nothing: reports on rows in these files, and in all .jsonl files of these folders.
    #[arg(long, num_args = 1.., value_name = "ROWS")]
    pub report: Vec<PathBuf>,
    /// Heading of the page.
    #[arg(long, default_value = "Speed against error")]
    pub title: String,
    /// One job, as JSON: how the program calls itself.
    #[arg(long, hide = true)]
    pub worker: Option<String>,
    /// Given by `cargo bench`.
    #[arg(long, hide = true)]
    pub bench: bool,
}

const DEFAULT_SCENES: [&str; 5] =
    ["cornell-box", "bansal-room-1", "bansal-room-5", "door-ajar", "glass-caustic"];

impl Arguments {
    /// Refuses what can be refused before anything is rendered.
    pub fn check(&self) -> Result<(), String> {
        self.engines.iter().try_for_each(|engine| Way::named(engine).map(|_| ()))?;
        self.variants.iter().try_for_each(|variant| variant.parse::<Variant>().map(|_| ()))?;
        self.direct_lights()?;
        self.check_points()?;
        if !(self.epsilon.is_finite() && self.epsilon > 0.0) {
            return Err(format!("--epsilon {}: give a finite number above 0", self.epsilon));
        }
        let guide = self.settings()?.guide(Default::default());
        if let Some(GuideProblem { option, value, remedy }) = guide.problem() {
            return Err(format!("{option} {value}: {remedy}"));
        }
        if let Some(size) = self.size.as_deref().filter(|size| size.contains(&0)) {
            return Err(format!("--size {} {}: both must be above 0", size[0], size[1]));
        }
        Ok(())
    }

    pub fn scenes(&self) -> Vec<String> {
        match self.scenes.is_empty() {
            true => DEFAULT_SCENES.iter().map(|name| format!("scenes/{name}.toml")).collect(),
            false => self.scenes.clone(),
        }
    }

    pub fn direct_lights(&self) -> Result<Vec<bool>, String> {
        let read = |word: &String| match word.as_str() {
            "on" | "true" => Ok(vec![true]),
            "off" | "false" => Ok(vec![false]),
            "both" => Ok(vec![true, false]),
            other => Err(format!("--direct-light {other}: choose on, off or both")),
        };
        let mut all = Vec::new();
        for word in &self.direct_light {
            let wanted = read(word)?;
            all.extend(wanted.into_iter().filter(|on| !all.contains(on)).collect::<Vec<_>>());
        }
        Ok(all)
    }

    pub fn check_points(&self) -> Result<Checks, String> {
        let rising = |ok: bool, name: &str| {
            if ok { Ok(()) } else { Err(format!("{name}: give rising numbers above 0")) }
        };
        if !self.spp.is_empty() {
            rising(self.spp[0] > 0 && self.spp.windows(2).all(|pair| pair[0] < pair[1]), "--spp")?;
            return Ok(Checks::Samples(self.spp.clone()));
        }
        if self.seconds.is_empty() {
            rising(self.budget.is_finite() && self.budget > 0.0, "--budget")?;
            return Ok(Checks::geometric(self.budget, self.checks));
        }
        let above_0 = self.seconds.iter().all(|&s| s.is_finite() && s > 0.0);
        rising(above_0 && self.seconds.windows(2).all(|pair| pair[0] < pair[1]), "--seconds")?;
        Ok(Checks::Seconds(self.seconds.clone()))
    }

    pub fn size(&self) -> Option<(u32, u32)> {
        self.size.as_ref().map(|size| (size[0], size[1]))
    }

    pub fn settings(&self) -> Result<Settings, String> {
        Ok(Settings {
            first_seed: self.first_seed,
            seeds: self.seeds,
            checks: self.check_points()?,
            epsilon: self.epsilon,
            max_bounces: self.max_bounces,
            independent: self.independent,
            adapter: self.adapter.clone(),
            mixture: self.mixture,
            depth: self.depth,
            learning: self.learning,
            cell: self.cell,
            commit: self.commit.clone().unwrap_or_else(machine::commit),
        })
    }
}
