//! One level of a path from start to end: intersect, shade, test the shadow ray. GPU twin: kernels/transport/step.wesl

use super::items::RayItem;
use super::path::{ShadeOutcome, Split, Transport};
use super::split::MAX_SPLIT;
use crate::guiding::{Trail, Transition};
use crate::scene::shapes::{Hit, Ray};
use glam::Vec3;

/// `emitted` and `direct` are to be added to the path's radiance one after the other, as every schedule does.
#[derive(Clone, Debug, Default)]
pub struct StepOutcome {
    pub emitted: Vec3,
    pub direct: Vec3,
    /// The path goes on with this ray, the first of its copies if it is `split`.
    pub ray: Option<RayItem>,
    pub trail: Trail,
    pub split: Option<Box<Split>>,
}

impl Transport<'_> {
    #[inline]
    pub fn step(&self, ray: &RayItem, trail: &Trail) -> StepOutcome {
        let (hit, emitted) = self.meet(ray, trail);
        match hit {
            None => StepOutcome { emitted, ..Default::default() },
            Some(hit) => self.leave(ray, trail, hit),
        }
    }

    /// What a ray meets; if that is nothing, the light of the environment.
    #[inline(always)]
    pub fn meet(&self, ray: &RayItem, trail: &Trail) -> (Option<Hit>, Vec3) {
        let hit = self.search.intersect(Ray { origin: ray.origin, direction: ray.direction });
        if hit.is_some() {
            return (hit, Vec3::ZERO);
        }
        let value = self.environment_value(ray, trail);
        self.learn(&Transition { slot: trail.slot, value, ..Default::default() });
        (None, self.environment(ray))
    }

    /// What happens at the surface that it met, until the path leaves it.
    #[inline(always)]
    pub fn leave(&self, ray: &RayItem, trail: &Trail, hit: Hit) -> StepOutcome {
        let shaded = self.shade(ray, trail, hit);
        self.learn(&shaded.transition);
        let direct = match shaded.shadow {
            Some(shadow) => {
                let towards = Ray { origin: shadow.origin, direction: shadow.direction };
                let blocked = self.search.occluded(towards, shadow.t_max, shadow.light_shape);
                if blocked {
                    Vec3::ZERO
                } else {
                    self.learn(&Transition {
                        slot: trail.slot,
                        value: shaded.shadow_value,
                        ..Default::default()
                    });
                    shadow.radiance
                }
            }
            None => Vec3::ZERO,
        };
        let ShadeOutcome { emitted, ray, trail, split, .. } = shaded;
        StepOutcome { emitted, direct, ray, trail, split }
    }

    /// Adds a transition to the pass's sums.
    #[inline(always)]
    pub fn learn(&self, transition: &Transition) {
        if let Some(guidance) = self.guidance
            && guidance.table.uniforms.learning != 0
        {
            guidance.sums.learn(guidance.table, transition);
        }
    }

    /// The radiance that a whole path brings to the camera, and how many rays it took, shadow rays not counted. Each copy
    /// has a sum of its own, as on a GPU, where they are traced in any order.
    #[inline]
    pub fn trace(&self, path: u32) -> (Vec3, u32) {
        let first = self.generate(path);
        let (mut ray, mut trail) = (first, Trail::default());
        let (mut sum, mut sums) = (Vec3::ZERO, [Vec3::ZERO; MAX_SPLIT as usize]);
        let mut waiting = Vec::new();
        let mut rays = 0;
        loop {
            let outcome = self.step(&ray, &trail);
            rays += 1;
            sum += outcome.emitted;
            sum += outcome.direct;
            if let Some(split) = &outcome.split {
                waiting.extend((1..split.copies).filter_map(|copy| self.copy_of(split, copy)));
            }
            if let Some(next) = outcome.ray {
                (ray, trail) = (next, outcome.trail);
                continue;
            }
            sums[(ray.path - first.path) as usize] = sum;
            let Some(copy) = waiting.pop() else { break };
            (sum, (ray, trail)) = (Vec3::ZERO, copy);
        }
        let sums = sums[1..self.places as usize].iter().fold(sums[0], |all, sum| all + sum);
        (sums, rays)
    }
}
