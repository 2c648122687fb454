//! Between two levels: the pool is filled up, and nothing is lost or started twice.

use super::*;
use qtracer::gpu::stage::{Argument, GRID_WIDTH, argument_words, length_rows};

/// The step between two levels: survivors and fresh paths fill the pool exactly, no path is started twice or never, and
/// the dispatch arguments cover every item.
#[test]
fn preparing_a_level_fills_the_pool_and_loses_no_path() {
    let harness =
        Harness::new(Stage::PrepareRays, &CompiledScene::new(&scene("cornell-box")), Schedule::Streamed);
    let mut runner = TestRunner::new_with_rng(
        ProptestConfig { cases: 40, failure_persistence: None, ..Default::default() },
        proptest::test_runner::TestRng::deterministic_rng(proptest::test_runner::RngAlgorithm::ChaCha),
    );
    let pool = (1u32..1 << 25, 0.0..=1.0f64, 0u32..1 << 25, 0.0..=1.0f64, 0.0..=1.0f64);
    let strategy = (pool, 1u32..=8, 1u32..=64, 0..4u32);
    runner
        .run(&strategy, |((capacity, full, paths, begun, shadowed), grain, longest_visit, few)| {
            // Some levels of a pool that has been drained.
            let full = if few == 0 { full / 16.0 } else { full };
            let begun = if few == 0 { 1.0 } else { begun };
            let survivors = (f64::from(capacity) * full) as u32;
            let next = (f64::from(paths) * begun) as u32;
            let shadows = (f64::from(capacity) * shadowed) as u32;
            let counters = harness.counters(&[
                (Counter::Survivors, survivors),
                (Counter::NextPath, next),
                (Counter::Shadows, shadows),
                (Counter::Rays, 100),
                (Counter::Levels, 7),
                (Counter::FirstHit, 17),
            ]);
            let arguments = vec![UNTOUCHED; argument_words(&harness.key) as usize];
            let lengths = vec![UNTOUCHED; 4 * length_rows(&harness.key) as usize];
            let least_rays = capacity / 8;
            let own = Uniforms { capacity, path_count: paths, ..Uniforms::zeroed() };
            let uniforms = Uniforms { grain, longest_visit, least_rays, ..own };
            let read = harness.run(
                uniforms,
                &[
                    ("counters", bytemuck::cast_slice(&counters)),
                    ("arguments", bytemuck::cast_slice(&arguments)),
                    ("lengths", bytemuck::cast_slice(&lengths)),
                ],
                1,
                &["counters", "arguments", "lengths"],
            );
            let (after, arguments, lengths) = (words(&read[0]), words(&read[1]), words(&read[2]));
            let counter = |c: Counter| after[c as usize];
            let fresh = (capacity - survivors).min(paths - next);
            prop_assert_eq!(counter(Counter::Live), survivors + fresh);
            prop_assert_eq!(counter(Counter::FreshBegin), survivors);
            prop_assert_eq!(counter(Counter::NextPath), next + fresh);
            prop_assert_eq!(counter(Counter::Rays), 100 + survivors + fresh);
            prop_assert_eq!(counter(Counter::Levels), 7 + u32::from(survivors + fresh + shadows > 0));
            prop_assert_eq!(counter(Counter::ShadowsLive), shadows);
            prop_assert_eq!(counter(Counter::Overflow), 0);
            // Where few are left, they go further, as far as they may and until a level traces least_rays.
            let (live, visit) = (u64::from((survivors + fresh).max(1)), counter(Counter::Visit));
            let within = |visit: u32| live * u64::from(visit) <= u64::from(least_rays);
            prop_assert!(visit == grain || visit <= longest_visit && within(visit), "{visit} of {live}");
            prop_assert!(visit >= longest_visit || !within(visit + 1), "{visit} levels of {live} rays");
            prop_assert!(visit >= grain);
            let told = [Counter::Live, Counter::FreshBegin, Counter::NextPath, Counter::ShadowsLive];
            for told in told.into_iter().chain([Counter::Visit]) {
                prop_assert_eq!(lengths[told as usize], counter(told), "{:?}", told);
            }
            for cleared in [Counter::Survivors, Counter::Shadows, Counter::FirstHit] {
                prop_assert_eq!(counter(cleared), 0);
            }
            for (slot, items) in [
                (Argument::Generate, fresh),
                (Argument::Intersect, survivors + fresh),
                (Argument::Shadow, shadows),
            ] {
                let [x, y, z] = [0, 1, 2].map(|i| arguments[3 * slot as usize + i]);
                prop_assert!(x <= GRID_WIDTH && y <= 65_535 && z == 1, "{slot:?}: {x} {y} {z}");
                let invocations = u64::from(x) * u64::from(y) * u64::from(WORKGROUP);
                prop_assert!(invocations >= u64::from(items), "{slot:?}: {x} × {y} for {items}");
                // In full rows, no more than one of waste.
                let row = u64::from(GRID_WIDTH * WORKGROUP);
                prop_assert!(invocations < u64::from(items) + row.max(u64::from(WORKGROUP)));
                prop_assert!(items > 0 || invocations == 0);
            }
            Ok(())
        })
        .unwrap();
}

/// Where paths split, fresh ones are admitted as far as there is room for all copies that those in flight and they may
/// still become, and never further.
#[test]
fn preparing_a_level_leaves_room_for_every_copy() {
    let compiled = CompiledScene::new(&scene("cornell-box"));
    for split in [2, 5, 8] {
        let estimators = Estimators { split, ..estimators(GuideMode::Adaptive, Roulette::Learnt) };
        let harness = Harness::with(Stage::PrepareRays, &compiled, Schedule::Fused, estimators);
        for (capacity, survivors, owned, paths, next, fresh) in [
            (256, 0, 0, 1000, 0, 256 / split),
            (256, 0, 0, 7, 3, 4),
            (256, 20, 20, 1000, 100, 236 / split),
            (256, 20, 20 * split, 1000, 100, (256 - 20 * split) / split),
            (256, 250, 256, 1000, 100, 0),
            (256, 256, 256, 1000, 1000, 0),
            (1 << 22, 5, 8, 1 << 22, 0, ((1 << 22) - 8) / split),
        ] {
            let counters = harness.counters(&[
                (Counter::Survivors, survivors),
                (Counter::Places, owned),
                (Counter::NextPath, next),
            ]);
            let arguments = vec![UNTOUCHED; argument_words(&harness.key) as usize];
            let read = harness.run(
                Uniforms { capacity, path_count: paths, ..Uniforms::zeroed() },
                &[
                    ("counters", bytemuck::cast_slice(&counters)),
                    ("arguments", bytemuck::cast_slice(&arguments)),
                ],
                1,
                &["counters"],
            );
            let after = words(&read[0]);
            let counter = |c: Counter| after[c as usize];
            assert!(owned + fresh * split <= capacity, "the test is wrong");
            assert_eq!(counter(Counter::NextPath), next + fresh, "{split} {capacity} {survivors} {owned}");
            assert_eq!(counter(Counter::Live), survivors + fresh);
            assert_eq!((counter(Counter::Survivors), counter(Counter::Places)), (0, 0));
        }
    }
}
