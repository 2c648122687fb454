//! Learning: every transition is added up once.

use super::*;
use crate::tables::learnt;
use qtracer::guiding::{LessonLayout, LessonSums, Lessons, Transition, lessons};

/// Transitions of every kind: few slots, so that sums carry; values beyond 32 bits; what is no radiance; points without a
/// cell.
fn transition(i: u32, layout: &LessonLayout) -> Transition {
    let values = [0.0, 1.0, 1e-9, 3e4, 1e9, f32::MAX, f32::NAN, f32::INFINITY, -1.0, -0.0, 0.037];
    let at =
        |salt: u32, n: u32| i.wrapping_mul(2_654_435_761).wrapping_add(salt.wrapping_mul(40_503)) / 7 % n;
    let missed = at(1, 5) == 0;
    let visited =
        if missed { lessons::MISSING | at(2, layout.missing) } else { at(3, layout.visits.min(13)) };
    Transition {
        slot: at(4, layout.slots.min(29)),
        value: values[at(5, values.len() as u32) as usize],
        visited,
        visit: if missed { 1.0 } else { values[at(6, values.len() as u32) as usize] },
    }
}

/// The queue of transitions is added up exactly, in whatever order, to what Rust adds up; what lies behind its end is not.
#[test]
fn learning_adds_every_transition_exactly_once() {
    let compiled = CompiledScene::new(&scene("cornell-box"));
    let harness = Harness::guided(Stage::Learn, &compiled, Schedule::Streamed, GuideMode::Adaptive);
    let table = learnt(GuideMode::Adaptive, 1).table;
    let layout = LessonLayout::new(&table.uniforms);
    for n in [0u32, 1, 255, 256, 257, 20_000] {
        let transitions: Vec<Transition> = (0..n + 300).map(|i| transition(i, &layout)).collect();
        let counters = harness.counters(&[(Counter::TransitionsLive, n)]);
        let sums = vec![0u32; layout.words() as usize];
        let read = harness.run(
            Uniforms { capacity: n + 300, ..Uniforms::zeroed() },
            &[
                ("counters", bytemuck::cast_slice(&counters)),
                ("transitions", bytemuck::cast_slice(&transitions)),
                ("lessons", bytemuck::cast_slice(&sums)),
                ("guide", bytemuck::bytes_of(&table.uniforms)),
            ],
            n.div_ceil(WORKGROUP) + 1,
            &["lessons"],
        );
        let added = |count: u32| {
            let mut expected = LessonSums::new(layout);
            transitions[..count as usize].iter().for_each(|t| expected.learn(&table, t));
            expected.take()
        };
        let found = Lessons::from_words(layout, &words(&read[0]));
        assert!(found == added(n), "{n} transitions");
        // Negative control: without the last of those that count, the sums are others.
        assert!(n < 300 || found != added(n - 30), "{n} transitions");
        assert!(n < 300 || found.values.iter().any(|sum| *sum > 1 << 33), "no sum carried");
    }
}
