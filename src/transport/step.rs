//! One level of a path from start to end: intersect, shade, test the shadow ray. GPU twin: kernels/transport/step.wesl

use super::items::RayItem;
use super::path::Transport;
use crate::guiding::{Trail, Transition};
use crate::scene::shapes::Ray;
use glam::Vec3;

/// `emitted` and `direct` are to be added to the path's radiance one after the other, as every schedule does.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepOutcome {
    pub emitted: Vec3,
    pub direct: Vec3,
    /// The path goes on with this ray.
    pub ray: Option<RayItem>,
    pub trail: Trail,
}

impl Transport<'_> {
    #[inline]
    pub fn step(&self, ray: &RayItem, trail: &Trail) -> StepOutcome {
        let hit = self.lanes.intersect(Ray { origin: ray.origin, direction: ray.direction });
        let Some(hit) = hit else {
            self.learn(&Transition {
                slot: trail.slot,
                value: self.environment_value(trail),
                ..Default::default()
            });
            return StepOutcome { emitted: self.environment(ray), ..Default::default() };
        };
        let shaded = self.shade(ray, trail, hit);
        self.learn(&shaded.transition);
        let direct = match shaded.shadow {
            Some(shadow) => {
                let towards = Ray { origin: shadow.origin, direction: shadow.direction };
                let blocked = self.lanes.occluded(towards, shadow.t_max, shadow.light_shape);
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
        StepOutcome { emitted: shaded.emitted, direct, ray: shaded.ray, trail: shaded.trail }
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

    /// The radiance that a whole path brings to the camera, and how many rays it took, shadow rays not counted.
    #[inline]
    pub fn trace(&self, path: u32) -> (Vec3, u32) {
        let mut rays = 0;
        let mut radiance = Vec3::ZERO;
        let mut trail = Trail::default();
        let mut next = Some(self.generate(path));
        while let Some(ray) = next {
            let outcome = self.step(&ray, &trail);
            rays += 1;
            radiance += outcome.emitted;
            radiance += outcome.direct;
            (next, trail) = (outcome.ray, outcome.trail);
        }
        (radiance, rays)
    }
}
