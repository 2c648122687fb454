//! How much is done at once: by a submission, and by an invocation. Neither changes what is computed, only when.

/// How much work to submit at once: grows or shrinks so that a submission takes [`Pacer::TARGET`] seconds, short enough
/// that no driver takes the GPU for hung. It changes what is submitted together, never what is computed.
pub struct Pacer {
    amount: f64,
}

impl Pacer {
    /// Seconds of a submission; drivers on laptops reset a GPU that is busy for about two.
    const TARGET: f64 = 0.08;

    pub fn new(first: u32) -> Pacer {
        Pacer { amount: f64::from(first) }
    }

    pub fn amount(&self) -> u32 {
        self.amount as u32
    }

    /// Learns that `amount` took `seconds`.
    pub fn observe(&mut self, amount: u32, seconds: f64) {
        let fitting = f64::from(amount) * Self::TARGET / seconds.max(1e-6);
        // An amount that was cut short says little about larger ones: grow at most eightfold from what was seen.
        let grown = fitting.min(f64::from(amount) * 8.0);
        if grown > self.amount || fitting < self.amount {
            self.amount = grown.clamp(1.0, f64::from(u32::MAX));
        }
    }
}

/// How long paths are, by what was traced: what decides how much one invocation does at once (`grain` in the uniforms).
#[derive(Clone, Copy, Debug, Default)]
pub struct PathLengths {
    rays: u64,
    ended: u64,
}

/// Rays that must be traced before their number says anything.
const ENOUGH_RAYS: u64 = 1 << 16;
/// Levels at once while path lengths are unknown.
const FIRST_LEVELS: u32 = 2;
/// Most levels at once: by then the traffic of queues has gone, and what grows is the wait for the longest path.
const MOST_LEVELS: u32 = 8;
/// Paths after which an invocation of the megakernel has smoothed their lengths out.
const MOST_PATHS: u32 = 16;
/// Mean length, as a share of the longest, above which paths are much alike.
const MOST_ALIKE: f64 = 0.8;
/// Invocations that fill a large GPU; below, more paths for each would leave parts of it idle.
const INVOCATIONS: u32 = 1 << 18;

impl PathLengths {
    /// What was traced up to now in all: rays, and paths that are at their end.
    pub fn observe(&mut self, rays: u64, ended: u64) {
        if rays >= ENOUGH_RAYS {
            *self = PathLengths { rays, ended };
        }
    }

    /// Rays per path, None while too little is known.
    fn mean(&self) -> Option<f64> {
        (self.ended > 0).then(|| self.rays as f64 / self.ended as f64)
    }

    /// Levels of a path that the fused schedule traces before survivors go back to the queue. Long paths gain, since they
    /// travel less often; of short ones too many would end early and leave their invocations idle. By measurement on an
    /// H100 (docs/PERFORMANCE.md): 2 is best at 4 and 5 rays a path, 4 at 7; 4 and 8 are alike at 23 and 55.
    pub fn levels_at_once(&self) -> u32 {
        let Some(mean) = self.mean() else { return FIRST_LEVELS };
        let fitting = (mean / 1.7).max(1.0) as u32;
        (1 << fitting.ilog2()).min(MOST_LEVELS)
    }

    /// Paths that one invocation of the megakernel traces, of `count` in all. Where lengths differ, invocations that trace
    /// one path each wait for the longest of their subgroup; where nearly all run to the last level, they stay in step,
    /// which is worth keeping.
    pub fn paths_at_once(&self, count: u32, max_bounces: u32) -> u32 {
        let differ = self.mean().is_some_and(|mean| mean < MOST_ALIKE * f64::from(max_bounces));
        if differ { (count / INVOCATIONS).clamp(1, MOST_PATHS) } else { 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lengths(mean: u64) -> PathLengths {
        let mut lengths = PathLengths::default();
        lengths.observe(mean << 20, 1 << 20);
        lengths
    }

    #[test]
    fn grains_follow_the_lengths_of_paths() {
        assert_eq!([1, 4, 5, 7, 23, 55].map(|mean| lengths(mean).levels_at_once()), [1, 2, 2, 4, 8, 8]);
        assert_eq!(PathLengths::default().levels_at_once(), FIRST_LEVELS);
        let many = 1 << 24;
        assert_eq!([5, 23, 60].map(|mean| lengths(mean).paths_at_once(many, 64)), [16, 16, 1]);
        assert_eq!(lengths(7).paths_at_once(many, 8), 1, "nearly all run to the last level");
        assert_eq!(lengths(5).paths_at_once(1 << 16, 64), 1, "too few paths to fill a GPU");
        assert_eq!(PathLengths::default().paths_at_once(many, 64), 1);
    }

    #[test]
    fn a_handful_of_rays_says_nothing() {
        let mut lengths = lengths(23);
        lengths.observe(100, 1);
        assert_eq!(lengths.levels_at_once(), 8);
    }
}
