//! Russian roulette: whether a path is worth going on with. GPU twin: kernels/transport/roulette.wesl

use super::guide::GuidePoint;
use super::items::RayItem;
use super::path::Transport;
use super::split::{bounce_of, budget_of};
use crate::math::luminance;
use crate::random::SampleKey;
use crate::scene::compiled::{KIND_DIELECTRIC, KIND_ROUGH_DIELECTRIC, Material};
use glam::Vec3;
use std::fmt;

/// What decides whether a path goes on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Roulette {
    /// The level cap alone.
    Off,
    /// The path's throughput.
    #[default]
    Throughput,
    /// What the path is expected to bring, by what its cell has learnt, against an estimate of its pixel (Vorba & Křivánek
    /// 2016); by throughput where nothing is known.
    Learnt,
}

impl fmt::Display for Roulette {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Roulette::Off => "off",
            Roulette::Throughput => "throughput",
            Roulette::Learnt => "learnt",
        })
    }
}

/// Bounces from which roulette by throughput is played: the fourth surface and later ones.
pub const ROULETTE_FROM_BOUNCE: u32 = 3;
/// Roulette by throughput lets at least this share of paths go on, so that the steps of 2⁻²⁴ of the number that decides are
/// small against it: a chance of 2⁻²⁴ or less would else be taken for one of 2⁻²⁴, and dark paths come out too bright.
pub const LEAST_SURVIVAL_BY_THROUGHPUT: f32 = 1.0 / 1024.0;
/// Learnt roulette lets at least this share of paths go on, since what was learnt may be wrong.
pub const LEAST_SURVIVAL: f32 = 0.05;
/// Estimates of a pixel below this, 2⁻¹⁰⁰, are taken for none: quotients by less are not to be trusted on every GPU.
const LEAST_ESTIMATE: f32 = 7.888_609e-31;

impl Transport<'_> {
    /// Chance with which the path goes on, or how many copies of it are to go on on average; each carries the weight of
    /// the path over that. `throughput` includes this surface.
    #[inline(always)]
    pub(super) fn roulette_survival(
        &self,
        ray: &RayItem,
        throughput: Vec3,
        material: &Material,
        point: Option<&GuidePoint>,
        key: SampleKey,
    ) -> f32 {
        match (self.roulette, point) {
            (Roulette::Off, _) => 1.0,
            (Roulette::Learnt, Some(point)) => self
                .learnt_survival(ray, material, point, key)
                .unwrap_or_else(|| self.throughput_survival(throughput, bounce_of(ray), material.kind)),
            _ => self.throughput_survival(throughput, bounce_of(ray), material.kind),
        }
    }

    /// The largest component, up to 1. Never at glass, where the solid-angle factor comes and goes.
    #[inline]
    pub fn throughput_survival(&self, throughput: Vec3, bounce: u32, kind: u32) -> f32 {
        if bounce < ROULETTE_FROM_BOUNCE || kind == KIND_DIELECTRIC || kind == KIND_ROUGH_DIELECTRIC {
            return 1.0;
        }
        (throughput.max_element() * self.uniforms.roulette_scale).clamp(LEAST_SURVIVAL_BY_THROUGHPUT, 1.0)
    }

    /// What going on is expected to bring over the estimate of the pixel, at most as many copies as the path may become;
    /// None where either is unknown.
    #[inline]
    fn learnt_survival(
        &self,
        ray: &RayItem,
        material: &Material,
        point: &GuidePoint,
        key: SampleKey,
    ) -> Option<f32> {
        let estimate = self.guidance?.table.pixel_estimate(key.pixel);
        if point.mean <= 0.0 || estimate <= LEAST_ESTIMATE {
            return None;
        }
        let expected = luminance(ray.throughput * material.color) * point.share * point.mean;
        Some(
            (self.uniforms.roulette_scale * expected / estimate).clamp(LEAST_SURVIVAL, budget_of(ray) as f32),
        )
    }
}
