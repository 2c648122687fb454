//! How much is done at once: by a submission, and by an invocation. Neither changes what is computed, only when.

use crate::gpu::stage::MEGAKERNEL_WORKGROUP;

/// How much work to submit at once: grows or shrinks so that a submission takes [`Pacer::TARGET`] seconds, short enough
/// that no driver takes the GPU for hung. It changes what is submitted together, never what is computed.
pub struct Pacer {
    amount: f64,
}

impl Pacer {
    /// Seconds of a submission; drivers on laptops reset a GPU that is busy for about two.
    pub const TARGET: f64 = 0.08;

    pub fn new(first: u64) -> Pacer {
        Pacer { amount: first as f64 }
    }

    pub fn amount(&self) -> u64 {
        self.amount as u64
    }

    /// How much of what is `left` to submit: no small rest stays behind, which would leave most of the GPU idle.
    pub fn part(&self, left: u32) -> u32 {
        let left = u64::from(left);
        let amount = self.amount();
        (if 2 * left <= 3 * amount { left } else { amount }) as u32
    }

    /// Learns that `amount` took `seconds`.
    pub fn observe(&mut self, amount: u64, seconds: f64) {
        let amount = amount as f64;
        let fitting = amount * Self::TARGET / seconds.max(1e-6);
        // An amount that was cut short says little about larger ones: grow at most eightfold from what was seen.
        let grown = fitting.min(amount * 8.0);
        if grown > self.amount || fitting < self.amount {
            self.amount = grown.max(1.0);
        }
    }
}

/// How far a batch is in the wavefront.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Levels done.
    pub levels: u32,
    pub paths: u32,
    /// Paths that have left the camera.
    pub started: u32,
    /// Rays in the queue.
    pub flying: u32,
    /// Visits to all rays so far, about.
    pub visits: u32,
}

/// Least number of levels to record: those behind the last ray cost a few microseconds, another submission more.
const LEAST_LEVELS: u32 = 4;
/// Levels to record while nothing is known of a batch: what comes back then tells how many more.
pub const UNKNOWN_LEVELS: u32 = 16;

impl Progress {
    /// Levels that are left, about: until all paths have started, at the rate up to now; then until the last ray is gone, if
    /// the same share goes on at every level.
    pub fn levels_left(&self) -> u32 {
        let ended = self.started.saturating_sub(self.flying);
        if ended == 0 {
            return UNKNOWN_LEVELS;
        }
        let filling = f64::from(self.paths - self.started) / f64::from(ended) * f64::from(self.levels);
        // A visit of several levels may end nearly all; the last are longer than most.
        let visits = (f64::from(self.visits) / f64::from(ended)).max(1.5);
        let going_on = 1.0 - 1.0 / visits;
        let draining = f64::from(self.flying).max(1.0).ln() / -going_on.ln();
        (filling + draining).ceil().max(f64::from(LEAST_LEVELS)) as u32
    }
}

/// How long paths are, by what was traced: what decides how much one invocation does at once (`grain` in the uniforms).
#[derive(Clone, Copy, Debug)]
pub struct PathLengths {
    rays: u64,
    ended: u64,
    /// Levels of the longest paths.
    longest: u32,
    /// Whether roulette ends paths.
    roulette: bool,
    direct_light: bool,
}

/// Rays that must be traced before their number says anything.
const ENOUGH_RAYS: u64 = 1 << 16;
/// Levels at once while path lengths are unknown, with direct light and without.
const FIRST_LEVELS: u32 = 2;
const FIRST_LEVELS_PLAIN: u32 = 4;
/// Least levels at once: a visit for one never paid, whatever the scene.
const LEAST_LEVELS_AT_ONCE: u32 = 2;
/// Rays that a path has on average for each level that is traced at once, with direct light and without. By measurement on an
/// H100 (docs/PERFORMANCE.md), of all shipped scenes.
const RAYS_A_LEVEL: f64 = 1.42;
const RAYS_A_LEVEL_PLAIN: f64 = 0.92;
/// Most levels at once: by then the traffic of queues has gone, and what grows is the wait for the longest path.
const MOST_LEVELS: u32 = 8;
/// Paths after which an invocation of the megakernel has smoothed their lengths out.
const MOST_PATHS: u32 = 32;
/// Rays of a path on average below which most are camera rays. Those of neighbours do much alike, and the more paths an invocation
/// has had, the less its neighbours do what it does: scenes of 1.8 to 2.1 rays a path took 1.04 to 1.12 times as long with 32,
/// scenes of 2.7 and more 0.96 to 0.99 times as long as with 16.
const SHORT: f64 = 2.4;
const MOST_SHORT_PATHS: u32 = 8;
/// Mean length, as a share of the longest, above which paths are much alike.
const MOST_ALIKE: f64 = 0.8;
/// Levels up to which paths are taken for alike before any was traced, if roulette ends none: of Bansal's scenes with 8 levels
/// most paths live through 0.73 to 0.9 of them, of those with 64 through 0.08 to 0.87. Who guesses wrong that they differ loses
/// a tenth of the first submission, who guesses wrong that they are alike half of it.
const FEW_LEVELS: u32 = 16;
/// Invocations that fill a large GPU; below, more paths for each would leave parts of it idle.
const INVOCATIONS: u32 = 1 << 18;

/// How the workgroups of a dispatch of the megakernel share its paths: most get `grain` for each of their invocations, the last
/// ones fewer. Else the whole dispatch would wait for those that happen to begin last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shares {
    pub grain: u32,
    /// Workgroups that get `grain`.
    pub early_groups: u32,
    pub late_grain: u32,
}

/// Paths of the last workgroups together, for each path that an invocation of the others traces: enough that whatever early
/// workgroups are at work when they begin is done before they are.
const LATE_PATHS: u32 = 1 << 15;
/// How many times fewer paths an invocation of the last workgroups traces, but one at least.
const LATE_SHARE: u32 = 4;

impl Shares {
    pub fn new(count: u32, grain: u32) -> Shares {
        let late = (grain * LATE_PATHS).min(count / 2);
        let early_groups = (count - late) / (MEGAKERNEL_WORKGROUP * grain);
        Shares { grain, early_groups, late_grain: (grain / LATE_SHARE).max(1) }
    }

    /// Workgroups for `count` paths.
    pub fn groups(&self, count: u32) -> u32 {
        let late = count - self.early_groups * MEGAKERNEL_WORKGROUP * self.grain;
        self.early_groups + late.div_ceil(MEGAKERNEL_WORKGROUP * self.late_grain)
    }
}

impl PathLengths {
    /// Nothing is known but what the kernels do.
    pub fn unknown(max_bounces: u32, roulette: bool, direct_light: bool) -> Self {
        PathLengths { rays: 0, ended: 0, longest: max_bounces, roulette, direct_light }
    }

    /// What was traced up to now in all: rays, and paths that are at their end.
    pub fn observe(&mut self, rays: u64, ended: u64) {
        if rays >= ENOUGH_RAYS {
            (self.rays, self.ended) = (rays, ended);
        }
    }

    /// Rays per path, None while too little is known.
    fn mean(&self) -> Option<f64> {
        (self.ended > 0).then(|| self.rays as f64 / self.ended as f64)
    }

    /// Levels of a path that the fused schedule traces before survivors go back to the queue: a power of two. Long paths gain,
    /// since they travel less often; of short ones too many would end early and leave their invocations idle.
    pub fn levels_at_once(&self) -> u32 {
        let rays_a_level = if self.direct_light { RAYS_A_LEVEL } else { RAYS_A_LEVEL_PLAIN };
        let Some(mean) = self.mean() else {
            return if self.direct_light { FIRST_LEVELS } else { FIRST_LEVELS_PLAIN };
        };
        // Where nearly all run to the last level, they need not come back before; not measured with direct light.
        let alike = !self.direct_light && mean >= MOST_ALIKE * f64::from(self.longest);
        let fitting = if alike { self.longest } else { (mean / rays_a_level) as u32 };
        let fitting = fitting.clamp(LEAST_LEVELS_AT_ONCE, MOST_LEVELS);
        1 << fitting.ilog2()
    }

    /// Paths that one invocation of the megakernel traces, of `count` in all. Where lengths differ, invocations that trace
    /// one path each wait for the longest of their subgroup; where nearly all run to the last level, they stay in step,
    /// which is worth keeping.
    pub fn paths_at_once(&self, count: u32) -> u32 {
        let differ = match self.mean() {
            Some(mean) => mean < MOST_ALIKE * f64::from(self.longest),
            None => self.roulette || self.longest > FEW_LEVELS,
        };
        let short = self.mean().is_some_and(|mean| mean < SHORT);
        let most = if short { MOST_SHORT_PATHS } else { MOST_PATHS };
        if differ { (count / INVOCATIONS).clamp(1, most) } else { 1 }
    }
}

/// How many levels visits of the sorted schedule have. They end with the material, mostly long before a path's last level.
#[derive(Clone, Copy, Debug)]
pub struct VisitLengths {
    reckoned: u32,
    most: u32,
}

/// While nothing is known.
const FIRST_VISIT: u32 = 8;
const LEAST_VISIT: u32 = 2;
const MOST_VISIT: u32 = 64;

impl VisitLengths {
    pub fn unknown() -> Self {
        VisitLengths { reckoned: FIRST_VISIT, most: FIRST_VISIT }
    }

    /// Levels to reckon with for all visits of a submission: twice the mean of those seen.
    pub fn reckoned(&self) -> u32 {
        self.reckoned
    }

    /// Levels that a visit may have: twice what those had that were seen, whose mean doubles at most then, so that no submission
    /// takes longer than reckoned. To cut long visits short for good costs a fifth (docs/PERFORMANCE.md).
    pub fn most(&self) -> u32 {
        self.most
    }

    /// Learns that `visits` of `grain` levels at most, if the queues were full, traced `rays`. What is reckoned with falls by half
    /// at most.
    pub fn observe(&mut self, rays: u64, visits: u64, grain: u32) {
        if rays == 0 || 2 * rays < visits {
            return; // The queues were nearly empty.
        }
        let mean = rays as f64 / visits.max(1) as f64;
        let fitting = ((2.0 * mean).ceil() as u32).clamp(LEAST_VISIT, MOST_VISIT);
        self.reckoned = fitting.max(self.reckoned / 2);
        self.most = self.most.max(2 * grain).min(MOST_VISIT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paths of 64 levels at most, unless said.
    fn lengths(mean: f64) -> PathLengths {
        lengths_of(mean, 64, true)
    }
    fn lengths_of(mean: f64, longest: u32, direct_light: bool) -> PathLengths {
        let mut lengths = PathLengths::unknown(longest, false, direct_light);
        lengths.observe((mean * f64::from(1 << 20)) as u64, 1 << 20);
        lengths
    }

    #[test]
    fn visits_are_reckoned_to_have_twice_the_levels_that_they_have() {
        let mut lengths = VisitLengths::unknown();
        let mut after = |rays: u64, visits: u64, grain: u32| {
            lengths.observe(rays, visits, grain);
            [lengths.reckoned(), lengths.most()]
        };
        assert_eq!([after(300, 1000, 8), after(0, 0, 8), after(0, 1000, 8)], [[8, 8]; 3], "nearly empty");
        assert_eq!([after(1300, 1000, 8), after(1000, 1000, 8)], [[4, 16], [2, 16]], "as seen of 8");
        assert_eq!([after(5000, 1000, 16), after(10_000, 1000, 2)], [[10, 32], [20, 32]]);
        assert_eq!([after(40_000, 1000, 32), after(64_000, 1000, 64)], [[64, 64]; 2], "no path has more");
        assert_eq!([after(1000, 1000, 8), after(900, 1000, 8)], [[32, 64], [16, 64]], "half at most");
        assert_eq!(after(u64::MAX / 4, 1, 64), [64, 64]);
    }

    #[test]
    fn grains_follow_the_lengths_of_paths() {
        let levels = [1.0, 2.7, 5.6, 5.7, 11.3, 11.4, 55.0].map(|mean| lengths(mean).levels_at_once());
        assert_eq!(levels, [2, 2, 2, 4, 4, 8, 8]);
        let many = 1 << 25;
        assert_eq!([5.0, 23.0, 60.0].map(|mean| lengths(mean).paths_at_once(many)), [32, 32, 1]);
        assert_eq!(
            [1.3, 2.3, 2.5].map(|mean| lengths(mean).paths_at_once(many)),
            [8, 8, 32],
            "camera rays, mostly"
        );
        assert_eq!(lengths_of(7.0, 8, true).paths_at_once(many), 1, "nearly all run to the last level");
        assert_eq!(lengths(5.0).paths_at_once(1 << 16), 1, "too few paths to fill a GPU");
    }

    /// Workgroups of the two kinds hold all paths, and none is for nothing.
    #[test]
    fn the_last_workgroups_of_a_dispatch_get_less() {
        for count in [1, 127, 128, 129, 5000, 4_915_200, 1 << 25] {
            for grain in [1, 2, 3, 18, 32, 64] {
                let shares = Shares::new(count, grain);
                let early = MEGAKERNEL_WORKGROUP * grain * shares.early_groups;
                let late_groups = shares.groups(count) - shares.early_groups;
                let late = MEGAKERNEL_WORKGROUP * shares.late_grain * late_groups;
                assert!(early <= count && early + late >= count, "{count}: {shares:?}");
                assert!(
                    early + late < count + MEGAKERNEL_WORKGROUP * shares.late_grain,
                    "{count}: {shares:?}"
                );
            }
        }
        assert_eq!(Shares::new(1 << 24, 1).late_grain, 1);
        assert_eq!(Shares::new(1 << 25, 32), Shares { grain: 32, early_groups: 7936, late_grain: 8 });
    }

    /// Bansal's experiments and room, 8 levels: what took the least time on an H100, or 3 % more at most.
    #[test]
    fn short_paths_without_direct_light_go_further_at_once() {
        let plain = |mean: f64| lengths_of(mean, 8, false).levels_at_once();
        assert_eq!([3.79, 4.71, 4.85, 5.82].map(plain), [4; 4]);
        assert_eq!([6.77, 6.92, 7.15].map(plain), [8; 3], "nearly all run to the last level");
        let lit = |mean: f64| lengths_of(mean, 8, true).levels_at_once();
        assert_eq!([3.79, 4.85, 5.82, 7.15].map(lit), [2, 2, 4, 4]);
    }

    #[test]
    fn guesses_go_by_what_ends_paths() {
        let many = 1 << 25;
        let guess = |longest, roulette| PathLengths::unknown(longest, roulette, true).paths_at_once(many);
        assert_eq!([guess(8, false), guess(8, true), guess(64, false), guess(64, true)], [1, 32, 32, 32]);
        assert_eq!(PathLengths::unknown(64, true, true).levels_at_once(), 2);
        assert_eq!(PathLengths::unknown(64, true, false).levels_at_once(), 4);
    }

    #[test]
    fn a_handful_of_rays_says_nothing() {
        let mut lengths = lengths(23.0);
        lengths.observe(100, 1);
        assert_eq!(lengths.levels_at_once(), 8);
    }

    #[test]
    fn submissions_grow_eightfold_and_shrink_at_once() {
        let mut pacer = Pacer::new(1000);
        pacer.observe(1000, 1e-3);
        assert_eq!(pacer.amount(), 8000);
        pacer.observe(8000, 0.16);
        assert_eq!(pacer.amount(), 4000, "half the time was aimed at");
        pacer.observe(500, 1e-3);
        assert_eq!(pacer.amount(), 4000, "a part says nothing of more than eight times as much");
    }

    #[test]
    fn no_small_rest_is_left() {
        let pacer = Pacer::new(1000);
        assert_eq!([400, 1000, 1500, 1501, 9000].map(|left| pacer.part(left)), [400, 1000, 1500, 1000, 1000]);
    }

    /// Batches of whose rays 1/`visits` end at every level: as many levels are foretold as they need.
    #[test]
    fn levels_are_foretold() {
        for (paths, capacity, visits, seen) in
            [(5e6, 4e6, 2.0, 7), (2e7, 4e6, 2.0, 7), (3e7, 4e6, 6.0, 7), (1e6, 4e6, 3.0, 2)]
        {
            let (mut started, mut flying, mut levels): (f64, f64, u32) = (0.0, 0.0, 0);
            let (mut seen_visits, mut foretold) = (0.0, 0);
            while started < paths || flying >= 1.0 {
                let fresh = f64::min(capacity - flying, paths - started);
                started += fresh;
                seen_visits += flying + fresh;
                flying = (flying + fresh) * (1.0 - 1.0 / visits);
                levels += 1;
                if levels == seen {
                    let (started, flying) = (started as u32, flying as u32);
                    let at =
                        Progress { levels, paths: paths as u32, started, flying, visits: seen_visits as u32 };
                    foretold = levels + at.levels_left();
                }
            }
            let ratio = f64::from(foretold) / f64::from(levels);
            assert!((0.85..=1.3).contains(&ratio), "{foretold} levels foretold, {levels} needed");
        }
    }

    #[test]
    fn a_batch_at_its_end_or_its_beginning_has_levels_left() {
        let at = |started, flying| Progress { levels: 1, paths: 1 << 20, started, flying, visits: 1 << 20 };
        assert_eq!(at(1 << 20, 0).levels_left(), LEAST_LEVELS);
        assert_eq!(at(1 << 20, 1).levels_left(), LEAST_LEVELS);
        assert_eq!(at(1 << 18, 1 << 18).levels_left(), UNKNOWN_LEVELS, "nothing has ended");
    }
}
