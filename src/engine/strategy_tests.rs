//! Which passes follow, by what the ones before were worth.

use super::*;

const PLAIN: Strategy =
    Strategy { informed: false, roulette: Roulette::Throughput, roulette_scale: PLAIN_SCALE, ripe: false };
use crate::guiding::{GuideOptions, Learner};
use glam::Vec3;
use std::sync::Arc;

fn planner(trial: bool, sampler: Sampler) -> Planner {
    planner_of(trial, sampler, 10)
}
fn planner_of(trial: bool, sampler: Sampler, tests_per_ray: usize) -> Planner {
    let guide = GuideOptions { mode: GuideMode::Adaptive, trial, ..Default::default() };
    let estimators = Estimators {
        direct_light: true,
        roulette: Roulette::Learnt,
        roulette_scale: 2.5,
        split: 1,
        sampler,
        max_bounces: 64,
        guide: GuideMode::Adaptive,
    };
    let options = RenderOptions { guide, ..Default::default() };
    Planner::new(&options, estimators, EngineKind::Wavefront, tests_per_ray)
}

/// The passes up to the last, where a sample's variance is as told, informed and plain, with the same rays.
fn passes(planner: Planner, informed: f64, plain: f64) -> Vec<Pass> {
    passes_of(planner, informed, plain, 5.0)
}
fn passes_of(mut planner: Planner, informed: f64, plain: f64, rays: f64) -> Vec<Pass> {
    let mut passes = vec![planner.first()];
    while let Some(pass) = passes.last().copied().filter(|pass| pass.end < u32::MAX) {
        planner.judge(&pass, if pass.strategy.informed { informed } else { plain }, rays);
        passes.push(planner.next(pass.end, None));
    }
    passes
}
fn ends(passes: &[Pass]) -> Vec<u32> {
    passes.iter().map(|pass| pass.end).collect()
}

#[test]
fn without_a_choice_passes_double_until_learning_ends() {
    let passes = passes(planner(false, Sampler::Independent), 100.0, 1.0);
    assert_eq!(ends(&passes), [4, 8, 16, 32, 64, 128, 256, 512, u32::MAX]);
    assert!(passes[..8].iter().all(|pass| pass.teaches()) && !passes[8].teaches());
}

#[test]
fn octants_learn_for_a_quarter_as_long() {
    let lessons =
        |mode, learning_samples| GuideOptions { mode, learning_samples, ..Default::default() }.lessons();
    let planner = |mode, asked| Planner {
        learning_samples: lessons(mode, asked),
        ..planner(false, Sampler::Independent)
    };
    let learnt = |mode, asked| {
        let passes = passes(planner(mode, asked), 1.0, 1.0);
        passes.iter().filter(|pass| pass.teaches()).map(|pass| pass.end).max()
    };
    assert_eq!(
        [GuideMode::Adaptive, GuideMode::Octant].map(|mode| learnt(mode, None)),
        [Some(512), Some(128)]
    );
    assert_eq!(learnt(GuideMode::Octant, Some(512)), Some(512));
}

#[test]
fn a_guide_that_does_not_pay_is_given_up_as_soon_as_it_is_compared() {
    let passes = passes(planner(true, Sampler::Independent), 100.0, 10.0);
    assert_eq!(ends(&passes), [16, 20, 24, 32, 64, 80, 128, u32::MAX]);
    assert!((passes[0].strategy, passes[0].teaches()) == (PLAIN, false));
    assert!(passes[1..7].iter().all(Pass::teaches));
    assert!((passes[7].strategy, passes[7].teaches()) == (PLAIN, false) && passes[7].gives_up());
}

#[test]
fn a_guide_that_pays_learns_on() {
    let passes = passes(planner(true, Sampler::Independent), 1.0, 10.0);
    assert_eq!(ends(&passes), [16, 20, 24, 32, 64, 80, 128, 256, 512, u32::MAX]);
    assert!(passes[1..].iter().all(|pass| pass.strategy.informed) && !passes[9].teaches());
}

/// Strategies of the passes, where a sample's variance is as told with paths that end by throughput, by what was learnt, and plain.
fn roulettes(mut planner: Planner, unripe: f64, ripe: f64, plain: f64) -> Vec<(u32, Strategy)> {
    let mut pass = planner.first();
    let mut strategies = vec![(pass.end, pass.strategy)];
    while pass.end < u32::MAX {
        let informed = if pass.strategy.ripe { ripe } else { unripe };
        planner.judge(&pass, if pass.strategy.informed { informed } else { plain }, 5.0);
        pass = planner.next(pass.end, None);
        strategies.push((pass.end, pass.strategy));
    }
    strategies
}

#[test]
fn roulette_goes_by_what_was_learnt_unless_throughput_does_better() {
    let trial = || planner(true, Sampler::Independent);
    let ripe = |strategies: &[(u32, Strategy)]| -> Vec<u32> {
        strategies.iter().filter(|(_, strategy)| strategy.ripe).map(|(end, _)| *end).collect()
    };
    let better = roulettes(trial(), 2.0, 1.0, 10.0);
    assert_eq!(ripe(&better), [80, 128, 256, 512, u32::MAX]);
    let worse = roulettes(trial(), 2.0, 5.0, 10.0);
    assert_eq!(ripe(&worse), [80]);
    let last = worse.last().unwrap().1;
    assert!(last.informed && last.roulette == Roulette::Learnt);
    assert_eq!(last.roulette_scale, PLAIN.roulette_scale);
    // It is not the worse roulette that the guide is judged by.
    let saved = roulettes(trial(), 2.0, 50.0, 10.0);
    assert!(ripe(&saved) == [80] && saved.last().unwrap().1.informed);
    assert_eq!(roulettes(trial(), 20.0, 50.0, 10.0)[6..], [(128, last), (u32::MAX, PLAIN)]);
}

/// Who asks for a guide and that roulette gets it.
#[test]
fn without_a_choice_roulette_ripens_whatever_it_does() {
    let planner = || planner(false, Sampler::Independent);
    let strategies = roulettes(planner(), 1.0, 100.0, 1.0);
    assert!(strategies.iter().all(|(end, strategy)| strategy.ripe == (*end > 64)));
    assert!(strategies.iter().all(|(_, strategy)| strategy.roulette_scale == 2.5));
}

fn loaded() -> Arc<Learner> {
    let options = GuideOptions { mode: GuideMode::Adaptive, ..Default::default() };
    Arc::new(Learner::new(options, Vec3::ZERO, Vec3::ONE, 1.0).expect("it fits"))
}

/// A planner of so many lessons, with a guide that was loaded or none.
fn planner_with(samples: u32, table: Option<Arc<Learner>>, trial: bool) -> Planner {
    let guide = GuideOptions {
        mode: GuideMode::Adaptive,
        learning_samples: Some(samples),
        trial,
        ..Default::default()
    };
    let options = RenderOptions { guide, guide_table: table, ..Default::default() };
    let estimators =
        Estimators { roulette: Roulette::Learnt, guide: GuideMode::Adaptive, ..Default::default() };
    Planner::new(&options, estimators, EngineKind::Cpu, 10)
}

/// What was loaded is ripe, and compared all the same where there is a choice; else nothing is ripe that few samples have taught.
#[test]
fn roulette_ripens_by_enough_lessons_or_loaded_ones() {
    assert_eq!([32, 33, 64].map(|n| planner_with(n, None, false).ripens), [u32::MAX, 64, 64]);
    assert_eq!([false, true].map(|trial| planner_with(0, Some(loaded()), trial).ripens), [0, 64]);
}

#[test]
fn a_loaded_guide_is_tried_however_little_is_to_come() {
    for (table, tried) in [(None, false), (Some(loaded()), true)] {
        let mut planner = planner_with(0, table, true);
        let prelude = planner.first();
        planner.judge(&prelude, 10.0, 5.0);
        assert_eq!(planner.next(prelude.end, Some(32)).strategy.informed, tried);
    }
}

#[test]
fn where_rays_walk_for_long_no_pass_is_short() {
    let planner = |trial| planner_of(trial, Sampler::Independent, 2 * LONG_WALK);
    assert_eq!(ends(&passes(planner(true), 1.0, 10.0))[..3], [16, 32, 64]);
    assert_eq!(ends(&passes(planner(false), 1.0, 10.0))[..3], [16, 32, 64]);
}

#[test]
fn a_guide_that_grows_worse_is_given_up_at_the_second_comparison() {
    let mut planner = planner(true, Sampler::Independent);
    let mut pass = planner.first();
    while pass.end < u32::MAX {
        let variance = if pass.end > 128 { 20.0 } else { 1.0 };
        planner.judge(&pass, if pass.strategy.informed { variance } else { 10.0 }, 5.0);
        assert!(pass.end <= 256, "{pass:?}");
        pass = planner.next(pass.end, None);
    }
    assert!(pass.gives_up());
}

/// With a loaded guide there may be nothing to learn; whether it pays is asked all the same.
#[test]
fn comparisons_come_whatever_is_learnt() {
    for (learning_samples, expected) in [
        (0, vec![16, 64, 80, 128, 256, u32::MAX]),
        (1, vec![16, 20, 64, 80, 128, 256, u32::MAX]),
        (32, vec![16, 20, 24, 32, 64, 80, 128, 256, u32::MAX]),
        (128, vec![16, 20, 24, 32, 64, 80, 128, 256, u32::MAX]),
        (512, vec![16, 20, 24, 32, 64, 80, 128, 256, 512, u32::MAX]),
    ] {
        let mut planner = planner(true, Sampler::Independent);
        planner.learning_samples = learning_samples;
        assert_eq!(ends(&passes(planner, 5.5, 10.0)), expected, "{learning_samples}");
    }
}

/// At 1.5 times the cost, 0.65 of the variance pays, but not 1.1 times that.
#[test]
fn what_a_guide_loses_by_breaking_strata_up_is_counted() {
    for (sampler, kept) in [(Sampler::Stratified, false), (Sampler::Independent, true)] {
        let passes = passes(planner(true, sampler), 65.0, 100.0);
        assert_eq!(passes.last().unwrap().strategy.informed, kept, "{sampler:?}");
    }
}

#[test]
fn a_guide_is_tried_where_enough_is_to_come() {
    for (expected, tried) in [(None, true), (Some(310), true), (Some(290), false), (Some(16), false)] {
        let mut planner = planner(true, Sampler::Independent);
        let prelude = planner.first();
        planner.judge(&prelude, ENOUGH / 300.0, 5.0);
        assert_eq!(planner.next(prelude.end, expected).strategy.informed, tried, "{expected:?}");
    }
}

#[test]
fn smooth_scenes_and_short_paths_need_no_guide_where_samples_are_stratified() {
    for (plain, rays) in [(100.0, 0.9 * SHORT), (0.9 * SMOOTH, 5.0)] {
        let given_up = passes_of(planner(true, Sampler::Stratified), 0.1 * plain, plain, rays);
        assert_eq!(ends(&given_up), [PRELUDE, u32::MAX]);
        assert!(given_up[1].gives_up());
        let kept = passes_of(planner(true, Sampler::Independent), 0.1 * plain, plain, rays);
        assert!(kept.last().unwrap().strategy.informed);
    }
}
