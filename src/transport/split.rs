//! Splitting: a path that is worth more than one goes on as several copies. Each has a share of the path's places for
//! radiance to itself, so that no two rays in flight add to the same one. GPU twin: kernels/transport/split.wesl

use super::items::RayItem;

/// The most copies that a path may become, and so the most places that it has.
pub const MAX_SPLIT: u32 = 8;
/// Bits of `RayItem::bounce` below its budget.
pub const BUDGET_SHIFT: u32 = 8;
/// How far the number of a copy's place moves its seed: places draw numbers of their own, the first those of a path that
/// never splits. Two renders whose seeds differ in these upper bits alone share numbers, if not at the same places.
pub const SEED_SHIFT: u32 = 29;

/// Surfaces met so far.
pub fn bounce_of(ray: &RayItem) -> u32 {
    ray.bounce & ((1 << BUDGET_SHIFT) - 1)
}

/// How many places the ray's path owns from its own on: how many copies it may become.
pub fn budget_of(ray: &RayItem) -> u32 {
    (ray.bounce >> BUDGET_SHIFT) + 1
}

/// The word that [`bounce_of`] and [`budget_of`] read; where nothing splits, it is the bounce itself.
pub fn pack_bounce(bounce: u32, budget: u32) -> u32 {
    bounce | (budget - 1) << BUDGET_SHIFT
}

/// How many copies go on where `expected` are to: that many on average over `u`, never more than its next whole number.
pub fn copies_of(expected: f32, u: f32) -> u32 {
    let whole = expected as u32;
    whole + u32::from(u < expected - whole as f32)
}

/// The places of a path from `place` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    pub place: u32,
    pub budget: u32,
}

/// What the copy with that number, the first being 0, gets of a path's share: as much as any other, but for one place.
pub fn share_of(whole: Share, copies: u32, copy: u32) -> Share {
    let each = whole.budget / copies;
    let left_over = whole.budget - each * copies;
    let place = whole.place + each * copy + copy.min(left_over);
    Share { place, budget: each + u32::from(copy < left_over) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Shares are disjoint, in order, never empty, and together what there was; and so again when shares are shared.
        #[test]
        fn copies_share_the_places_of_their_path(
            place in 0u32..1 << 28, budget in 1..=MAX_SPLIT, expected in 0.0f32..8.0, u in 0.0f32..1.0, again in 1..=MAX_SPLIT
        ) {
            let whole = Share { place, budget };
            let copies = copies_of(expected.min(budget as f32), u);
            prop_assert!(copies <= budget);
            let mut next = place;
            for copy in 0..copies {
                let share = share_of(whole, copies, copy);
                prop_assert!(share.place == next && share.budget >= 1, "{share:?}");
                let parts = again.min(share.budget);
                let ends: Vec<u32> = (0..parts).map(|i| share_of(share, parts, i)).map(|s| s.place + s.budget).collect();
                prop_assert!(ends.windows(2).all(|w| w[0] < w[1]) && ends.last() == Some(&(share.place + share.budget)));
                next += share.budget;
            }
            prop_assert!(copies == 0 || next == place + budget, "{next}");
        }

        #[test]
        fn a_packed_bounce_keeps_both_numbers(bounce in 0u32..=64, budget in 1..=MAX_SPLIT) {
            let ray = RayItem { bounce: pack_bounce(bounce, budget), ..bytemuck::Zeroable::zeroed() };
            prop_assert_eq!((bounce_of(&ray), budget_of(&ray)), (bounce, budget));
            prop_assert!(budget > 1 || ray.bounce == bounce);
        }
    }

    /// As many as expected on average; certainly one where one is expected; seldom one where less is.
    #[test]
    fn copies_are_as_many_as_expected() {
        for expected in [0.0f32, 0.05, 0.7, 1.0, 1.3, 2.0, 3.999, 8.0] {
            let n = 4096;
            let counts: Vec<u32> = (0..n).map(|i| copies_of(expected, i as f32 / n as f32)).collect();
            let mean = counts.iter().sum::<u32>() as f32 / n as f32;
            assert!((mean - expected).abs() <= 1.0 / n as f32, "{mean} for {expected}");
            assert!(counts.iter().all(|&c| (c as f32 - expected).abs() < 1.0), "{expected}");
        }
    }
}
