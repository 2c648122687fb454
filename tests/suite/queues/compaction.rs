//! Compaction: what lives is kept exactly once, and what does not fit is reported.

use super::*;
use std::cell::Cell;

/// Compacts the rays that are marked live behind `already` others. The counters and the queue afterwards.
fn compact(harness: &Harness, live: &[bool], already: u32, capacity: u32) -> (Vec<u32>, Vec<RayItem>) {
    let rays: Vec<RayItem> =
        live.iter().zip(0..).map(|(&live, i)| marked_ray(i, if live { i } else { NONE })).collect();
    let counters = harness.counters(&[(Counter::Live, live.len() as u32), (Counter::Survivors, already)]);
    let read = harness.run(
        Uniforms { capacity, ..Uniforms::zeroed() },
        &[
            ("counters", bytemuck::cast_slice(&counters)),
            ("rays_in", bytemuck::cast_slice(&to_planes(&rays, 0, capacity))),
            ("rays_out", bytemuck::cast_slice(&to_planes(&[], 0, capacity))),
        ],
        // More than the rays need: invocations past the end must do nothing.
        live.len().div_ceil(WORKGROUP as usize) as u32 + 1,
        &["counters", "rays_out"],
    );
    let planes = words(&read[1]);
    assert!(
        planes[12 * capacity as usize..].iter().all(|w| *w == UNTOUCHED),
        "wrote past the end of the queue"
    );
    (words(&read[0]), from_planes(&planes, capacity))
}

/// What is wrong with a compaction, if anything.
fn compaction_fault(live: &[bool], already: u32, counters: &[u32], queue: &[RayItem]) -> Option<String> {
    let expected: BTreeSet<u32> = live.iter().zip(0..).filter(|(live, _)| **live).map(|(_, i)| i).collect();
    let end = already as usize + expected.len();
    if counters[Counter::Survivors as usize] as usize != end {
        return Some(format!("{} survivors for {end}", counters[Counter::Survivors as usize]));
    }
    if counters[Counter::Overflow as usize] != 0 {
        return Some(format!("overflow {:b}", counters[Counter::Overflow as usize]));
    }
    let found: Vec<u32> = queue[already as usize..end].iter().map(|ray| ray.path).collect();
    let distinct: BTreeSet<u32> = found.iter().copied().collect();
    if distinct.len() != found.len() || distinct != expected {
        return Some(format!("{found:?} for {expected:?}"));
    }
    if let Some(ray) = queue[already as usize..end].iter().find(|ray| **ray != marked_ray(ray.path, ray.path))
    {
        return Some(format!("{ray:?} was changed"));
    }
    let outside = queue[..already as usize].iter().chain(&queue[end..]);
    outside.into_iter().any(|ray| !is_untouched(ray)).then(|| "wrote outside its slots".to_string())
}

/// Patterns of live and dead, how many rays lie there already, and a capacity that holds what comes in. Lengths about
/// workgroups and their edges, shares from none to all.
fn patterns() -> impl Strategy<Value = (Vec<bool>, u32, u32)> {
    let length = prop_oneof![Just(0), Just(1), 254usize..=258, 510usize..=514, 0usize..1500];
    let share = prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64];
    let patterns =
        (share, length).prop_flat_map(|(share, n)| prop::collection::vec(prop::bool::weighted(share), n));
    // Room for all that come in, for some of those that live, or for none.
    (patterns, 0u32..2000, 0.0..1.3f64).prop_map(|(live, already, room)| {
        let survivors = live.iter().filter(|&&live| live).count() as u32;
        let capacity = already + (f64::from(survivors) * room).round() as u32;
        let capacity = capacity.max(live.len() as u32).max(1);
        (live, already, capacity)
    })
}

/// Live paths are kept once each if all fit; else as many as fit, the queue's bit says so, and nothing is written over or
/// beyond.
#[test]
fn compaction_keeps_each_live_path_exactly_once() {
    let harness =
        Harness::new(Stage::Compact, &CompiledScene::new(&scene("cornell-box")), Schedule::Compacted);
    let overflows = Cell::new(0);
    let law = |(live, already, capacity): (Vec<bool>, u32, u32)| {
        let (counters, queue) = compact(&harness, &live, already, capacity);
        let survivors = live.iter().filter(|&&live| live).count() as u32;
        if already + survivors <= capacity {
            prop_assert_eq!(compaction_fault(&live, already, &counters, &queue), None);
        } else {
            prop_assert_eq!(overflow_fault(&live, already, &counters, &queue), None);
            overflows.set(overflows.get() + 1);
        }
        Ok(())
    };
    law((vec![], 700, 700)).unwrap();
    law((vec![true; 256], 0, 256)).unwrap();
    law((vec![true; 600], 1, 600)).unwrap();
    runner(40).run(&patterns(), law).unwrap();
    assert!(overflows.get() >= 5, "only {overflows:?} cases ran over");
}

/// What is wrong with a compaction of more than fits, if anything.
fn overflow_fault(live: &[bool], already: u32, counters: &[u32], queue: &[RayItem]) -> Option<String> {
    if counters[Counter::Overflow as usize] != 1 << Counter::Survivors as u32 {
        return Some(format!("overflow {:b}", counters[Counter::Overflow as usize]));
    }
    let (before, behind) = queue.split_at(already as usize);
    if !before.iter().all(is_untouched) {
        return Some("wrote over what was there already".to_string());
    }
    let kept: BTreeSet<u32> = behind.iter().map(|ray| ray.path).collect();
    let lives = |path: &u32| live.get(*path as usize).copied().unwrap_or(false);
    let whole = behind.iter().all(|ray| *ray == marked_ray(ray.path, ray.path));
    let right = kept.len() == behind.len() && kept.iter().all(lives) && whole;
    (!right).then(|| format!("kept {kept:?} in {} places", behind.len()))
}

/// Negative control: a path lost, doubled, changed or put beyond the end is found.
#[test]
fn a_faulty_compaction_is_found() {
    let harness =
        Harness::new(Stage::Compact, &CompiledScene::new(&scene("cornell-box")), Schedule::Compacted);
    let live: Vec<bool> = (0..600).map(|i| i % 2 == 0).collect();
    let (counters, queue) = compact(&harness, &live, 5, 4096);
    assert_eq!(compaction_fault(&live, 5, &counters, &queue), None);
    type Fault<'a> = &'a dyn Fn(&mut [u32], &mut [RayItem]);
    let faults: [Fault; 5] = [
        &|counters, _| counters[Counter::Survivors as usize] -= 1,
        &|counters, _| counters[Counter::Overflow as usize] = 2,
        &|_, queue| queue[7] = queue[8],
        &|_, queue| queue[7].pdf += 1.0,
        &|_, queue| queue[304 + 5] = marked_ray(1, 1),
    ];
    for (i, fault) in faults.iter().enumerate() {
        let (mut counters, mut queue) = (counters.clone(), queue.clone());
        fault(&mut counters, &mut queue);
        assert!(compaction_fault(&live, 5, &counters, &queue).is_some(), "fault {i} was not found");
    }
    // The same of a queue that ran over.
    let (counters, queue) = compact(&harness, &live, 500, 700);
    assert_eq!(overflow_fault(&live, 500, &counters, &queue), None);
    let faults: [Fault; 4] = [
        &|counters, _| counters[Counter::Overflow as usize] = 0,
        &|_, queue| queue[499] = queue[500],
        &|_, queue| queue[501] = queue[500],
        &|_, queue| queue[502] = untouched_ray(),
    ];
    for (i, fault) in faults.iter().enumerate() {
        let (mut counters, mut queue) = (counters.clone(), queue.clone());
        fault(&mut counters, &mut queue);
        let found = overflow_fault(&live, 500, &counters, &queue).is_some();
        assert!(found, "fault {i} of a queue that ran over was not found");
    }
}

/// What does not fit is not written anywhere, and the queue's bit says so.
#[test]
fn a_push_past_capacity_sets_the_overflow_bit_and_writes_nothing_beyond() {
    let harness =
        Harness::new(Stage::Compact, &CompiledScene::new(&scene("cornell-box")), Schedule::Compacted);
    for (live, already, capacity, overflows) in [
        (600, 0, 599, true),
        (600, 0, 600, false),
        (600, 100, 650, true),
        (1, 700, 700, true),
        (0, 700, 700, false),
    ] {
        let (counters, queue) = compact(&harness, &vec![true; live], already, capacity);
        let bit = u32::from(overflows) << Counter::Survivors as u32;
        assert_eq!(counters[Counter::Overflow as usize], bit, "{live} behind {already} in {capacity}");
        let written = queue.iter().filter(|ray| !is_untouched(ray)).count() as u32;
        assert_eq!(written, (live as u32).min(capacity - already));
        assert!(queue[..already as usize].iter().all(is_untouched), "wrote over what was there already");
    }
}
