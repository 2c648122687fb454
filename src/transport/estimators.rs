//! What is estimated and how.

use super::roulette::Roulette;
use crate::guiding::GuideMode;
use crate::random::Sampler;

/// The estimators of a render: the caller's choices, and the scene's where the caller made none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimators {
    /// Next-event estimation, combined with the other directions by multiple importance sampling.
    pub direct_light: bool,
    pub roulette: Roulette,
    /// Survival in roulette is this times what it would be, up to certainty.
    pub roulette_scale: f32,
    /// Copies that learnt roulette may make of a path, 1 to 8.
    pub split: u32,
    pub sampler: Sampler,
    /// Levels of a path, 1 to 64.
    pub max_bounces: u32,
    pub guide: GuideMode,
}

impl Estimators {
    /// Whether a table is learnt: for directions or for roulette.
    pub fn learns(&self) -> bool {
        self.guide != GuideMode::Off || self.roulette == Roulette::Learnt
    }

    /// Places that a path has for its radiance, one for each copy that it may become.
    pub fn places(&self) -> u32 {
        if self.roulette == Roulette::Learnt { self.split.max(1) } else { 1 }
    }

    /// The kind of table. Learnt roulette alone keeps an adaptive one, which then guides nothing.
    pub fn table_mode(&self) -> GuideMode {
        if self.guide == GuideMode::Off { GuideMode::Adaptive } else { self.guide }
    }
}
