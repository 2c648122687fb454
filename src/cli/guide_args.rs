//! `render`: what is learnt, how it is kept and shown.

use super::console;
use super::failure::Failure;
use super::values;
use clap::{Args, ValueEnum};
use qtracer::engine::{Estimators, GuideView};
use qtracer::guiding::{GuideMode, GuideOptions, Learner};
use qtracer::transport::roulette::Roulette;
use std::path::PathBuf;
use std::sync::Arc;

/// Help on a number whose default the library decides.
struct Help(&'static str);

const DEPTH: Help = Help("adaptive: how often each eighth of the directions may be quartered");
const MIXTURE: Help =
    Help("octant, adaptive: share of directions that are guided, once a cell is well known");
const DISCOUNT: Help = Help("bansal: what the next surface's best direction counts");
const THRESHOLD: Help = Help("bansal: directions worth less than this share of the best are drawn again");
const LEARNING: Help =
    Help("Samples per pixel that teach, rounded up to whole passes; 0 uses a loaded guide as it is");
const MEMORY: Help = Help("Memory at which cells are no longer cut finer: 64M, 2G");

impl Help {
    fn with(&self, default: impl std::fmt::Display) -> String {
        format!("{} [default: {default}]", self.0)
    }
}

/// Of most guides, and of octants.
fn lessons() -> String {
    let of = |mode| GuideOptions { mode, ..default() }.lessons().next_power_of_two();
    format!("{}; octant: {}", of(GuideMode::Adaptive), of(GuideMode::Octant))
}

fn default() -> GuideOptions {
    GuideOptions::default()
}

#[derive(Args)]
pub struct GuideArgs {
    /// Learn where light comes from, and send paths there. auto is adaptive where it turns out to pay, else off;
    /// bansal is that paper's rule, which is biased; all others converge to the truth [default: auto; off with
    /// --spp or --max-spp below 256, in scenes that switch roulette off, and with --roulette, --roulette-scale or --split]
    #[arg(long, value_enum)]
    guide: Option<GuideArg>,

    /// Edge of the largest cells that learn, in scene units [default: a 16th of where paths go; bansal: 0.5]
    #[arg(long, value_name = "SIZE", value_parser = values::length, allow_negative_numbers = true)]
    guide_cell: Option<f32>,

    #[arg(long, help = DEPTH.with(default().depth), value_name = "0..7", value_parser = clap::value_parser!(u32).range(0..=7), allow_negative_numbers = true)]
    guide_depth: Option<u32>,

    #[arg(long, help = MIXTURE.with(default().mixture), value_name = "0..0.95", value_parser = values::mixture, allow_negative_numbers = true)]
    guide_mixture: Option<f32>,

    /// How much of what was learnt is forgotten with each pass; bansal: the step of each update
    /// [default: 0.75; bansal: 0.0001]
    #[arg(long, value_name = "0..1", value_parser = values::share, allow_negative_numbers = true)]
    guide_alpha: Option<f32>,

    #[arg(long, help = DISCOUNT.with(default().discount), value_name = "0..1", value_parser = values::share, allow_negative_numbers = true)]
    guide_discount: Option<f32>,

    #[arg(long, help = THRESHOLD.with(default().threshold), value_name = "0..1", value_parser = values::share, allow_negative_numbers = true)]
    guide_threshold: Option<f32>,

    #[arg(long, help = LEARNING.with(lessons()), value_name = "N", value_parser = clap::value_parser!(u32), allow_negative_numbers = true)]
    guide_learning: Option<u32>,

    #[arg(long, help = MEMORY.with(format_args!("{}M", default().memory >> 20)), value_name = "SIZE", value_parser = values::bytes, allow_negative_numbers = true)]
    guide_memory: Option<u64>,

    /// Keep what was learnt in this file
    #[arg(long, value_name = "FILE")]
    save_guide: Option<PathBuf>,

    /// Start from what an earlier render has learnt, of this scene or one like it
    #[arg(long, value_name = "FILE")]
    load_guide: Option<PathBuf>,

    /// Make .png images pictures of what was learnt: mean radiance, mean direction of the light, the cells, or how
    /// widely light comes in. Implies --guide-layers
    #[arg(
        long,
        value_enum,
        value_name = "illumination|direction|cells|entropy",
        hide_possible_values = true
    )]
    show: Option<ShowArg>,

    /// Add what was learnt to .exr images: guide.illumination, .direction, .cell, .entropy
    #[arg(long)]
    guide_layers: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum GuideArg {
    Off,
    Bansal,
    BansalReweighted,
    Octant,
    Adaptive,
    Auto,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ShowArg {
    Illumination,
    Direction,
    Cells,
    Entropy,
}

/// Files and pictures of what is learnt.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GuideJob {
    pub save: Option<PathBuf>,
    pub show: Option<GuideView>,
    /// Whether .exr images get what was learnt.
    pub layers: bool,
    /// Whether nothing was said of a guide: the render goes on without one where none can be had.
    pub unasked: bool,
}

impl GuideArgs {
    /// What was asked for; `tried` says whether a guide is to be tried where nothing was said of it.
    pub fn options(&self, tried: bool) -> GuideOptions {
        let default = default();
        let unsaid = if tried && !self.needs_a_guide() { GuideArg::Auto } else { GuideArg::Off };
        let guide = self.guide.unwrap_or(unsaid);
        GuideOptions {
            mode: match guide {
                GuideArg::Off => GuideMode::Off,
                GuideArg::Bansal => GuideMode::Bansal,
                GuideArg::BansalReweighted => GuideMode::BansalReweighted,
                GuideArg::Octant => GuideMode::Octant,
                GuideArg::Adaptive | GuideArg::Auto => GuideMode::Adaptive,
            },
            trial: guide == GuideArg::Auto,
            cell_size: self.guide_cell,
            depth: self.guide_depth.unwrap_or(default.depth),
            mixture: self.guide_mixture.unwrap_or(default.mixture),
            alpha: self.guide_alpha,
            discount: self.guide_discount.unwrap_or(default.discount),
            threshold: self.guide_threshold.unwrap_or(default.threshold),
            learning_samples: self.guide_learning,
            mature_samples: default.mature_samples,
            memory: self.guide_memory.unwrap_or(default.memory),
        }
    }

    /// Whether there are files or pictures of what is learnt: a guide that may be given up does not go without saying then.
    fn needs_a_guide(&self) -> bool {
        self.save_guide.is_some() || self.load_guide.is_some() || self.show.is_some() || self.guide_layers
    }

    /// The guide to start from, if it goes with what is asked for.
    pub fn loaded(&self, estimators: &Estimators) -> Result<Option<Arc<Learner>>, Failure> {
        let Some(path) = &self.load_guide else { return Ok(None) };
        let learner = Learner::load(path).map_err(Failure::bad_input)?;
        let (learnt, wanted) = (learner.mode(), estimators.table_mode());
        if learnt != wanted {
            let path = path.display();
            return Err(Failure::bad_input(format!(
                "cannot use \"{path}\": it was learnt with --guide {learnt}, and --guide {wanted} can't read it; \
                 ask for --guide {learnt}, or learn anew without --load-guide"
            )));
        }
        Ok(Some(Arc::new(learner)))
    }

    /// Options that go together, or an error that says which do not.
    pub fn check(&self, estimators: &Estimators, outputs: &[PathBuf]) -> Result<GuideJob, Failure> {
        let guide = estimators.guide;
        if guide.is_bansal() && estimators.roulette == Roulette::Learnt {
            return Err(Failure::bad_input(format!(
                "--roulette learnt cannot be used with --guide {guide}, which does not learn how much light there is; \
                 use --roulette throughput, or --guide adaptive"
            )));
        }
        let uses = [
            ("--save-guide", self.save_guide.is_some()),
            ("--load-guide", self.load_guide.is_some()),
            ("--show", self.show.is_some()),
            ("--guide-layers", self.guide_layers),
        ];
        if let Some((option, _)) = uses.iter().find(|(_, given)| *given && !estimators.learns()) {
            return Err(Failure::bad_input(format!(
                "{option} needs something that learns; add --guide adaptive (or octant, or --roulette learnt)"
            )));
        }
        if let Some(path) = &self.save_guide {
            Learner::check_writable(path).map_err(Failure::bad_input)?;
            if outputs.contains(path) {
                let path = path.display();
                return Err(Failure::bad_input(format!(
                    "\"{path}\" is given to both -o and --save-guide; name two files"
                )));
            }
        }
        self.warn(estimators);
        Ok(GuideJob {
            save: self.save_guide.clone(),
            show: self.show.map(|show| match show {
                ShowArg::Illumination => GuideView::Illumination,
                ShowArg::Direction => GuideView::Direction,
                ShowArg::Cells => GuideView::Cells,
                ShowArg::Entropy => GuideView::Entropy,
            }),
            layers: self.guide_layers || self.show.is_some(),
            unasked: self.guide.is_none(),
        })
    }

    fn warn(&self, estimators: &Estimators) {
        if estimators.guide.is_biased() {
            console::warning(format!(
                "--guide {} is biased, as published: the image does not converge to the truth; \
                 bansal-reweighted, octant and adaptive do",
                estimators.guide
            ));
        }
        let teaches_nothing = self.guide_learning == Some(0) && self.load_guide.is_none();
        if estimators.learns() && teaches_nothing {
            console::warning("--guide-learning 0 without --load-guide: there is nothing to be guided by");
        }
        self.idle(estimators).iter().for_each(console::warning);
    }

    /// Options that were given and change nothing.
    fn idle(&self, estimators: &Estimators) -> Vec<String> {
        let guide = estimators.guide;
        let (adaptive, bansal) = (guide == GuideMode::Adaptive, guide.is_bansal());
        let mixes = adaptive || guide == GuideMode::Octant;
        let learns = estimators.learns();
        const LEARN: &str = "--guide adaptive, --guide octant or --roulette learnt";
        let options = [
            ("--guide-cell", self.guide_cell.is_some(), learns, LEARN),
            ("--guide-depth", self.guide_depth.is_some(), adaptive, "--guide adaptive"),
            ("--guide-mixture", self.guide_mixture.is_some(), mixes, "--guide adaptive or octant"),
            ("--guide-alpha", self.guide_alpha.is_some(), learns, LEARN),
            ("--guide-discount", self.guide_discount.is_some(), bansal, "--guide bansal"),
            ("--guide-threshold", self.guide_threshold.is_some(), bansal, "--guide bansal"),
            ("--guide-learning", self.guide_learning.is_some(), learns, LEARN),
            ("--guide-memory", self.guide_memory.is_some(), learns, LEARN),
        ];
        let idle = options.into_iter().filter(|(_, given, used, _)| *given && !used);
        let mut warnings: Vec<String> = idle
            .map(|(option, .., home)| {
                format!("{option} has no effect with --guide {guide}; it goes with {home}")
            })
            .collect();
        if self.guide_cell.is_some() && self.load_guide.is_some() {
            warnings.push("--guide-cell has no effect: a loaded guide keeps its cells".to_string());
        }
        warnings
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        guide: GuideArgs,
    }

    fn parse(text: &str) -> GuideArgs {
        Line::try_parse_from(std::iter::once("qtracer").chain(text.split_whitespace())).unwrap().guide
    }

    #[test]
    fn a_guide_is_tried_unasked_unless_something_needs_one() {
        let way = |text, tried| (parse(text).options(tried).mode, parse(text).options(tried).trial);
        assert_eq!(way("", true), (GuideMode::Adaptive, true));
        for (text, tried) in
            [("", false), ("--guide off", true), ("--save-guide x", true), ("--guide-layers", true)]
        {
            assert_eq!(way(text, tried), (GuideMode::Off, false), "{text}");
        }
        for tried in [false, true] {
            assert_eq!(way("--guide adaptive", tried), (GuideMode::Adaptive, false));
            assert_eq!(way("--guide auto", tried), (GuideMode::Adaptive, true));
        }
    }

    #[test]
    fn options_reach_the_library() {
        assert_eq!(parse("").options(false), GuideOptions::default());
        let all = "--guide octant --guide-cell 0.25 --guide-depth 3 --guide-mixture 0.9 --guide-alpha 0.5 \
                   --guide-discount 0.7 --guide-threshold 0.6 --guide-learning 64 --guide-memory 1M";
        let expected = GuideOptions {
            trial: false,
            mode: GuideMode::Octant,
            cell_size: Some(0.25),
            depth: 3,
            mixture: 0.9,
            alpha: Some(0.5),
            discount: 0.7,
            threshold: 0.6,
            learning_samples: Some(64),
            mature_samples: GuideOptions::default().mature_samples,
            memory: 1 << 20,
        };
        assert_eq!(parse(all).options(true), expected);
    }

    #[test]
    fn idle_options_are_named_with_where_they_belong() {
        let idle = |text: &str, roulette: Roulette| {
            let args = parse(text);
            let guide = args.options(false).mode;
            args.idle(&Estimators { guide, roulette, ..Default::default() })
        };
        let learnt = Roulette::Learnt;
        assert_eq!(idle("--guide adaptive --guide-depth 3 --guide-cell 1", Roulette::Off).len(), 0);
        assert_eq!(idle("--guide-cell 1 --guide-memory 1M", learnt).len(), 0);
        assert_eq!(idle("--guide-cell 1 --guide-memory 1M", Roulette::Throughput).len(), 2);
        assert_eq!(idle("--guide-depth 1 --guide-mixture 0.1", learnt).len(), 2);
        let octant = idle("--guide octant --guide-depth 3 --guide-discount 0.5 --guide-mixture 0.2", learnt);
        assert_eq!(octant.len(), 2);
        assert!(octant[0].contains("--guide-depth") && octant[0].contains("--guide octant"), "{octant:?}");
        let bansal = idle("--guide bansal --guide-mixture 0.5 --guide-threshold 0.5", Roulette::Off);
        assert_eq!(bansal.len(), 1);
        assert!(bansal[0].contains("--guide-mixture"));
    }
}
