//! What the wavefront engine submits at once: how many levels, of how many rays, each visited for how many levels of its path.
//! Sums over what was seen, that a submission may take as long as it should and a batch needs few.

use super::pacing::{Pacer, PathLengths, Progress, UNKNOWN_LEVELS, VisitLengths};
use crate::gpu::stage::Schedule;

/// What is submitted at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Submission {
    pub levels: u32,
    /// Rays that are in flight in each, at most.
    pub rays: u32,
    /// Levels of its path that a visit to a ray traces: of `step` at least, of `follow_*` at most.
    pub grain: u32,
}

/// A batch, and the queues that it goes through.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    pub paths: u32,
    /// Rays that a queue holds.
    pub pool: u32,
    /// Places for radiance that a path has: so many rays it may become.
    pub places: u32,
    /// Levels that a path may have.
    pub max_bounces: u32,
}

impl Work {
    /// Levels after which any batch is done: the pool is filled again at the latest when all its paths are at their end. It
    /// holds as many paths as it has room for all their copies.
    pub fn most_levels(&self) -> u32 {
        let fillings = self.paths.div_ceil(self.pool / self.places) + 1;
        // Copies wait a level at each split on their way, which at least halves the places that they own.
        let waits = self.places.next_power_of_two().ilog2();
        fillings * (self.max_bounces + waits + 1) + 4
    }
}

/// How far a batch is, by what the counters say behind a submission.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// Levels done.
    pub levels: u32,
    /// Paths that have left the camera.
    pub started: u32,
    /// Rays in the queue.
    pub flying: u32,
    /// Rays traced.
    pub rays: u32,
}

pub struct Submissions {
    schedule: Schedule,
    /// Levels of a path that a visit traces, if the caller decides.
    grain: Option<u32>,
    /// Levels of a path that the adapter can trace in a row.
    most_in_a_row: u32,
    /// In rays in flight, times levels that a visit is reckoned to have.
    pacer: Pacer,
    lengths: PathLengths,
    /// Of the sorted schedule.
    visits: VisitLengths,
    /// Levels that the last batch needed, 0 before the first: how many to record at first.
    expected_levels: u32,
}

impl Submissions {
    /// `first_rays`: rays of a first submission whose visits have so many levels.
    pub fn new(
        schedule: Schedule,
        grain: Option<u32>,
        most_in_a_row: u32,
        lengths: PathLengths,
        first_rays: impl Fn(u32) -> u64,
    ) -> Submissions {
        let (pacer, visits) = (Pacer::new(0), VisitLengths::unknown());
        let mut new =
            Submissions { schedule, grain, most_in_a_row, pacer, lengths, visits, expected_levels: 0 };
        new.pacer = Pacer::new(first_rays(new.visit_levels().1));
        new
    }

    /// What to submit next.
    pub fn next(&self, work: &Work, seen: &Seen) -> Submission {
        let amount = self.pacer.amount();
        let (mut grain, mut reckoned) = self.visit_levels();
        // A level is submitted whole, so it is the levels of a visit that must not be too many.
        while self.grain.is_none() && reckoned > 1 && u64::from(work.pool) * u64::from(reckoned) > amount {
            reckoned /= 2;
            grain = grain.min(if self.schedule == Schedule::Sorted { 2 * reckoned } else { reckoned });
        }
        let (mut rays, mut left) = (work.pool, self.levels_left(work, seen, reckoned));
        if self.leaves_none(work, grain) && seen.flying == 0 {
            let waiting = work.paths - seen.started;
            let in_time = (amount / u64::from(grain)).min(u64::from(waiting)) as u32;
            rays = in_time.max(waiting.min(work.pool));
            left = waiting.div_ceil(rays);
        }
        let in_time = amount / (u64::from(rays) * u64::from(reckoned));
        let levels = u64::from(left.min(work.most_levels())).min(in_time).max(1);
        Submission { levels: levels as u32, rays, grain }
    }

    /// Learns how long a submission took, and what it traced.
    pub fn learn(&mut self, work: &Work, made: &Submission, before: &Seen, after: &Seen, seconds: f64) {
        let traced = u64::from(after.rays.saturating_sub(before.rays));
        let visits = u64::from(made.levels) * u64::from(made.rays);
        let full = visits * u64::from(made.grain);
        let (amount, least) = match self.schedule {
            // Most visits end before their last level: what was traced took that long.
            Schedule::Sorted => (traced, visits),
            _ if self.leaves_none(work, made.grain) => (full, visits),
            _ => (full, full),
        };
        // Levels that were nearly empty say nothing of full ones, unless even they took too long.
        if 2 * traced >= least || seconds > Pacer::TARGET {
            self.pacer.observe(amount, seconds);
        }
        // A batch begins with fresh paths alone, whose visits end with their camera rays.
        if made.levels > 1 || before.flying >= made.rays / 2 {
            self.visits.observe(traced, visits, made.grain);
        }
        // At least so many: where paths split, several survivors may be of one.
        let ended = after.started.saturating_sub(after.flying);
        self.lengths.observe(u64::from(after.rays), u64::from(ended));
    }

    /// Learns how many levels of a batch had anything to do.
    pub fn end_batch(&mut self, busy_levels: u32) {
        self.expected_levels = busy_levels;
    }

    /// Levels of a path that visits may have where few rays are left: with a grain of the caller's, no more.
    pub fn longest_visit(&self, work: &Work) -> u32 {
        self.grain.unwrap_or(work.max_bounces).min(self.most_in_a_row)
    }

    /// Levels of a path that a visit traces, and how many to reckon with.
    fn visit_levels(&self) -> (u32, u32) {
        let both = |levels: u32| (levels, levels);
        let (grain, reckoned) = match self.schedule {
            Schedule::Fused => both(self.grain.unwrap_or_else(|| self.lengths.levels_at_once())),
            Schedule::Sorted => self.grain.map_or((self.visits.most(), self.visits.reckoned()), both),
            Schedule::Streamed | Schedule::Compacted => both(1),
        };
        (grain.min(self.most_in_a_row), reckoned.min(self.most_in_a_row))
    }

    /// Whether visits of so many levels trace paths to their ends. None comes back to a queue then, so there may be more at once
    /// than a queue holds.
    fn leaves_none(&self, work: &Work, grain: u32) -> bool {
        self.schedule == Schedule::Fused && work.places == 1 && grain >= work.max_bounces
    }

    /// Levels that are left: as many as the last batch needed, or by what is seen of this one.
    fn levels_left(&self, work: &Work, seen: &Seen, reckoned: u32) -> u32 {
        let visit = if self.schedule == Schedule::Sorted { (reckoned / 2).max(1) } else { reckoned };
        match self.expected_levels.saturating_sub(seen.levels) {
            0 if seen.levels == 0 => UNKNOWN_LEVELS,
            0 => Progress {
                levels: seen.levels,
                paths: work.paths,
                started: seen.started,
                flying: seen.flying,
                visits: seen.rays / visit,
            }
            .levels_left(),
            expected => expected,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A GPU that traces so many rays a second, and paths of which this part ends at every level.
    struct Gpu {
        rays_a_second: f64,
        ending: f64,
        /// Part that leaves a visit of the sorted schedule for another list, at every level.
        leaving: f64,
    }

    impl Gpu {
        /// Traces a submission; how far the batch is then, and how long that took.
        fn trace(&self, work: &Work, made: &Submission, sorted: bool, seen: &Seen) -> (Seen, f64) {
            let mut after = *seen;
            let mut traced = 0.0;
            for _ in 0..made.levels {
                let fresh = (made.rays - after.flying.min(made.rays)).min(work.paths - after.started);
                after.started += fresh;
                let mut going = f64::from(after.flying + fresh);
                let mut waiting = 0.0;
                for _ in 0..made.grain.min(work.max_bounces) {
                    traced += going;
                    going *= 1.0 - self.ending;
                    if sorted {
                        waiting += going * self.leaving;
                        going *= 1.0 - self.leaving;
                    }
                }
                let ended = !sorted && made.grain >= work.max_bounces;
                after.flying = if ended { 0 } else { (going + waiting) as u32 };
                after.levels += 1;
            }
            after.rays += traced as u32;
            (after, traced / self.rays_a_second)
        }

        /// Submissions of each of three batches, and the longest of all but the first batch.
        fn render(&self, submissions: &mut Submissions, work: &Work) -> ([u32; 3], f64) {
            let (mut counts, mut longest) = ([0; 3], 0.0);
            for (batch, count) in counts.iter_mut().enumerate() {
                let mut seen = Seen::default();
                while seen.started < work.paths || seen.flying > 0 {
                    let made = submissions.next(work, &seen);
                    let sorted = submissions.schedule == Schedule::Sorted;
                    let (after, seconds) = self.trace(work, &made, sorted, &seen);
                    submissions.learn(work, &made, &seen, &after, seconds);
                    seen = after;
                    *count += 1;
                    if batch > 0 {
                        longest = f64::max(longest, seconds);
                    }
                }
                submissions.end_batch(seen.levels);
            }
            (counts, longest)
        }
    }

    fn submissions(schedule: Schedule, first: u64) -> Submissions {
        let lengths = PathLengths::unknown(64, false, true);
        Submissions::new(schedule, None, 64, lengths, |_| first)
    }

    const WORK: Work = Work { paths: 20_000_000, pool: 1 << 22, places: 1, max_bounces: 64 };

    /// Paths of 41 levels, most of whose visits have one or two: few submissions, though the first guess is for less than a level.
    #[test]
    fn a_batch_takes_few_submissions_and_none_takes_long() {
        for (rays_a_second, leaving) in [(7.1e9, 0.8), (7.1e9, 0.1), (0.5e9, 0.8), (0.5e9, 0.3)] {
            let gpu = Gpu { rays_a_second, ending: 0.024, leaving };
            for schedule in [Schedule::Sorted, Schedule::Fused, Schedule::Streamed] {
                let ([_, second, third], longest) = gpu.render(&mut submissions(schedule, 38 << 20), &WORK);
                // What all of it takes, in submissions of the length that is aimed at. Sorted visits are reckoned to have twice what they
                // have, levels are whole, and the last ones nearly empty.
                let whole = 2e7 / 0.024 / rays_a_second / Pacer::TARGET;
                let most = (8.0 * whole + 10.0) as u32;
                assert!(
                    second <= most && third <= most,
                    "{schedule:?} {leaving}: {second}, {third} of {whole}"
                );
                assert!(longest < 2.5 * Pacer::TARGET, "{schedule:?} {leaving}: {longest} s");
            }
        }
    }

    /// Where all levels are traced at once, whatever the pool, and never more at once than there is time for.
    #[test]
    fn paths_traced_to_their_ends_start_together() {
        let work = Work { max_bounces: 8, ..WORK };
        let gpu = Gpu { rays_a_second: 30e9, ending: 0.02, leaving: 0.0 };
        let lengths = PathLengths::unknown(8, false, false);
        let mut fast = Submissions::new(Schedule::Fused, Some(8), 64, lengths, |_| 1 << 28);
        assert_eq!(fast.next(&work, &Seen::default()), Submission { levels: 1, rays: 20_000_000, grain: 8 });
        let ([first, second, third], longest) = gpu.render(&mut fast, &work);
        assert!(first == 1 && second == 1 && third == 1 && longest < Pacer::TARGET);
        // Rays in a queue: it must not be read by another capacity than it was written by.
        let seen = Seen { levels: 3, started: 1000, flying: 1, rays: 8000 };
        assert_eq!(fast.next(&work, &seen).rays, work.pool);
        let slow = Gpu { rays_a_second: 0.45e9, ..gpu };
        let mut submissions = Submissions::new(Schedule::Fused, Some(8), 64, lengths, |_| 1 << 25);
        let (_, longest) = slow.render(&mut submissions, &Work { paths: (1 << 23) + 400_000, ..work });
        assert!(longest < 2.5 * Pacer::TARGET, "{longest} s");
    }

    #[test]
    fn an_adapter_that_ends_loops_gets_short_visits() {
        let lengths = PathLengths::unknown(64, false, true);
        for schedule in [Schedule::Fused, Schedule::Sorted] {
            let software = Submissions::new(schedule, Some(64), 8, lengths, |_| 1 << 40);
            assert_eq!(software.next(&WORK, &Seen::default()).grain, 8);
            assert_eq!(software.longest_visit(&WORK), 8);
        }
        assert_eq!(submissions(Schedule::Fused, 1 << 30).longest_visit(&WORK), 64);
    }
}
