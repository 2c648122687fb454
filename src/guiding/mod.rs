//! What was learnt, and how it guides: Q-tables over cells of surface points × directions. Lower floors know nothing of it;
//! `transport` asks the table, engines collect the lessons and commit them to what is known, the [`Learner`] refines that
//! between passes.
//! docs/GUIDING.md has the mathematics.

pub mod commit;
mod file;
mod layout;
mod learner;
pub mod lessons;
pub mod octant;
pub mod quadtree;
mod refine;
pub mod state;
pub mod table;
mod tickets;

pub use file::{GuideFileError, VERSION as GUIDE_FILE_VERSION};
pub use learner::{Learner, LearnerError};
pub use lessons::{LessonLayout, LessonSums, Lessons, Trail, Transition};
pub use state::{Committed, GuideState, GuideUpdate, Stale};
pub use table::{GuideTable, GuideUniforms};

use std::fmt;

/// How directions are guided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum GuideMode {
    /// Directions are chosen by the materials alone.
    #[default]
    Off,
    /// Bansal 2018 as published: biased.
    Bansal,
    /// Bansal's rule divided by its density: unbiased, and noisy.
    BansalReweighted,
    /// Eight octants, the exact product of Q and the cosine, mixed with the material's own choice.
    Octant,
    /// Quadtrees rooted in the octants, mixed with the material's own choice.
    Adaptive,
}

impl GuideMode {
    /// Whether renders converge to something else than the truth.
    pub fn is_biased(self) -> bool {
        self == GuideMode::Bansal
    }

    /// Whether the rule is Bansal's, with or without its density.
    pub fn is_bansal(self) -> bool {
        matches!(self, GuideMode::Bansal | GuideMode::BansalReweighted)
    }
}

/// The largest share of guided directions.
pub const MAX_MIXTURE: f32 = 0.95;

impl fmt::Display for GuideMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            GuideMode::Off => "off",
            GuideMode::Bansal => "bansal",
            GuideMode::BansalReweighted => "bansal-reweighted",
            GuideMode::Octant => "octant",
            GuideMode::Adaptive => "adaptive",
        })
    }
}

/// What a caller may choose about guiding. Ranges are checked by [`GuideOptions::problem`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuideOptions {
    pub mode: GuideMode,
    /// Whether plain tracing is tried as well, and taken where guiding does not pay.
    pub trial: bool,
    /// Edge of a base cell in scene units; `None`: a 16th of the longest side of where paths go, for Bansal 0.5.
    pub cell_size: Option<f32>,
    /// Adaptive: levels of the quadtrees below an octant, 0 to 7.
    pub depth: u32,
    /// Share of guided directions, 0 to 0.95: unbiased guides need the materials' own choice too.
    pub mixture: f32,
    /// How much of what earlier passes taught is forgotten with each pass, 0 to 1; for Bansal the step of each update.
    pub alpha: Option<f32>,
    /// Bansal: what is left of the best Q of the next surface, 0 to 1.
    pub discount: f32,
    /// Bansal: octants below this share of the best are drawn again, 0 to 1.
    pub threshold: f32,
    /// Samples per pixel that teach, rounded up to whole passes, with a `trial` the plain ones from before as well as these are 32 or
    /// more; the rest only uses what was learnt. 0: nothing is learnt. `None`: as many as pay, [`GuideOptions::lessons`].
    pub learning_samples: Option<u32>,
    /// Samples per pixel from which on learnt roulette goes by what was learnt; before, paths end by throughput. What cells
    /// know after a few samples is so rough that roulette by it brought 3 to 9 times the noise at 16 (docs/GUIDING.md). With a `trial`, it
    /// goes on by throughput where that does better; and always where fewer samples than these teach.
    pub mature_samples: u32,
    /// Bytes that the table may take.
    pub memory: u64,
}

impl Default for GuideOptions {
    fn default() -> Self {
        GuideOptions {
            mode: GuideMode::Off,
            trial: false,
            cell_size: None,
            depth: quadtree::MAX_DEPTH,
            mixture: 0.7,
            alpha: None,
            discount: 0.8,
            threshold: 0.75,
            learning_samples: None,
            mature_samples: 64,
            memory: 256 << 20,
        }
    }
}

/// A number that is out of its range.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GuideProblem {
    /// Name of the field.
    pub option: &'static str,
    pub value: String,
    /// What to choose instead.
    pub remedy: &'static str,
}

impl GuideOptions {
    /// Samples per pixel that teach, given or not: 511, for octants 128. What eight octants are worth is known sooner than what
    /// the leaves of quadtrees are, and a sample that teaches costs a sixth more (docs/GUIDING.md, Cost).
    pub fn lessons(&self) -> u32 {
        self.learning_samples.unwrap_or(match self.mode {
            GuideMode::Octant => 128,
            _ => 511,
        })
    }

    /// The first number that is out of its range, if there is one. Where a mode does not use a number, it has to be in range
    /// all the same.
    pub fn problem(&self) -> Option<GuideProblem> {
        let share = |value: Option<f32>| value.is_none_or(|value| (0.0..=1.0).contains(&value));
        let cell = self.cell_size.is_none_or(|size| size.is_finite() && size > 0.0);
        let text = |value: Option<f32>| value.map_or(String::new(), |value| value.to_string());
        let checks = [
            (cell, "guide_cell", text(self.cell_size), "choose a size above 0, in scene units"),
            (self.depth <= quadtree::MAX_DEPTH, "guide_depth", self.depth.to_string(), "choose 0 to 7"),
            (
                (0.0..=MAX_MIXTURE).contains(&self.mixture),
                "guide_mixture",
                self.mixture.to_string(),
                "choose 0 to 0.95: without the materials' own choice the guide would be biased",
            ),
            (share(self.alpha), "guide_alpha", text(self.alpha), "choose 0 to 1"),
            (share(Some(self.discount)), "guide_discount", self.discount.to_string(), "choose 0 to 1"),
            (share(Some(self.threshold)), "guide_threshold", self.threshold.to_string(), "choose 0 to 1"),
        ];
        let wrong = checks.into_iter().find(|(right, ..)| !right);
        wrong.map(|(_, option, value, remedy)| GuideProblem { option, value, remedy })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_out_of_range_are_named() {
        let good = GuideOptions::default();
        assert_eq!(good.problem(), None);
        let edges = GuideOptions { depth: 0, mixture: 0.95, alpha: Some(1.0), threshold: 0.0, ..good };
        assert_eq!(edges.problem(), None);
        for (bad, option) in [
            (GuideOptions { cell_size: Some(0.0), ..good }, "guide_cell"),
            (GuideOptions { cell_size: Some(f32::INFINITY), ..good }, "guide_cell"),
            (GuideOptions { depth: 8, ..good }, "guide_depth"),
            (GuideOptions { mixture: 0.96, ..good }, "guide_mixture"),
            (GuideOptions { mixture: f32::NAN, ..good }, "guide_mixture"),
            (GuideOptions { alpha: Some(-0.1), ..good }, "guide_alpha"),
            (GuideOptions { discount: 1.1, ..good }, "guide_discount"),
            (GuideOptions { threshold: f32::NAN, ..good }, "guide_threshold"),
        ] {
            assert_eq!(bad.problem().map(|problem| problem.option), Some(option));
        }
    }
}
