//! What was learnt, and how it guides: Q-tables over cells of surface points × directions. Lower floors know nothing of it;
//! `transport` asks the table, engines collect the lessons, the [`Learner`] turns lessons into the next table.
//! docs/GUIDING.md has the mathematics.

mod learner;
pub mod lessons;
pub mod octant;
pub mod quadtree;
pub mod table;

pub use learner::{Learner, LearnerError};
pub use lessons::{LessonLayout, LessonSums, Lessons, Trail, Transition};
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
    /// Samples per pixel that teach; the rest only uses what was learnt.
    pub learning_samples: u32,
    /// Bytes that the table may take.
    pub memory: u64,
}

impl Default for GuideOptions {
    fn default() -> Self {
        GuideOptions {
            mode: GuideMode::Off,
            cell_size: None,
            depth: quadtree::MAX_DEPTH,
            mixture: 0.7,
            alpha: None,
            discount: 0.8,
            threshold: 0.75,
            learning_samples: 511,
            memory: 256 << 20,
        }
    }
}
