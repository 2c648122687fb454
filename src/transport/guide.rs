//! How the guide takes part in a path: what it knows at a surface, the mixture with the material's own choice, what is
//! learnt on the way. GPU twin: kernels/transport/guide.wesl

use super::path::Transport;
use crate::bsdf::lambert_share;
use crate::guiding::lessons::MISSING;
use crate::guiding::octant::{Draws, acceptance, octant_of, octant_shares, octant_wholes};
use crate::guiding::table::{Cell, CellPlace, GuidedDensity, NO_CELL, adaptive, bansal, octants};
use crate::guiding::{GuideMode, GuideTable, LessonSums, Transition};
use crate::math::{luminance, to_world};
use crate::sampling::{BELOW_ONE, pdf_cosine, sample_cosine};
use crate::scene::compiled::Material;
use crate::scene::shapes::Surface;
use glam::{Vec2, Vec3, Vec4Swizzles};
use std::f32::consts::FRAC_1_PI;

/// The table that is asked, and the sums that learn.
#[derive(Clone, Copy, Debug)]
pub struct Guidance<'a> {
    pub mode: GuideMode,
    pub table: &'a GuideTable,
    pub sums: &'a LessonSums,
}

/// Share of directions that the octants propose at most.
pub const MOST_PROPOSED: f32 = 0.95;
/// Share of what the octants know that must lie above the horizon for them to guide: shares are right to some 1e-7, so what is turned
/// down is known to a thousandth then.
pub const LEAST_SEEN: f32 = 1e-4;
/// Mean radiance below which they do not: quotients by less are not to be trusted.
pub const LEAST_RADIANCE: f32 = 1e-25;

/// What the guide knows at a surface point that has a Lambertian lobe.
#[derive(Clone, Copy, Debug)]
pub struct GuidePoint {
    pub place: CellPlace,
    pub cell: Cell,
    /// Probability with which a direction of the Lambertian lobe is guided.
    pub mixture: f32,
    /// Irradiance over π, as far as direct light does not account for it: times the albedo, what the lobe sends back.
    pub mean: f32,
    /// The Lambertian lobe's part of the material.
    pub share: f32,
    /// Octant guide: what a proposal of the octants is worth.
    pub proposed: f32,
}

impl GuidePoint {
    #[inline]
    fn mixture_pdf(&self, cosine: f32, guided: f32) -> f32 {
        self.share * ((1.0 - self.mixture) * cosine + self.mixture * guided)
    }
}

impl Transport<'_> {
    /// What the guide knows here; None where it has no part: guiding is off, or the material has no Lambertian lobe.
    #[inline(always)]
    pub fn guide_point(&self, surface: &Surface, normal: Vec3, material: &Material) -> Option<GuidePoint> {
        let guidance = self.guidance?;
        let share = lambert_share(material);
        if share <= 0.0 {
            return None;
        }
        let place = guidance.table.place(surface.position, normal);
        let cell = if place.cell == NO_CELL { Cell::default() } else { guidance.table.cell(place.row) };
        let (mean, proposed) = match guidance.mode {
            GuideMode::Octant if cell.trust > 0.0 => {
                let radiance = |weights| octants::radiance(&cell, &weights);
                (radiance(octant_shares(normal)), radiance(octant_wholes(normal)))
            }
            GuideMode::Adaptive => (cell.irradiance * FRAC_1_PI, 0.0),
            _ => (0.0, 0.0),
        };
        let asked = cell.trust * guidance.table.uniforms.mixture;
        let mixture = match guidance.mode {
            _ if mean <= 0.0 => 0.0,
            GuideMode::Octant if mean < LEAST_SEEN * cell.irradiance || mean < LEAST_RADIANCE => 0.0,
            // So many more as the horizon will turn down, so that as many are guided as were asked for.
            GuideMode::Octant => (asked * proposed).min(MOST_PROPOSED * mean) / mean,
            _ => asked,
        };
        Some(GuidePoint { place, cell, mixture, mean, share, proposed })
    }

    /// The guide's own density of `wi`, and the slot that learns about it.
    #[inline]
    fn guide_density(
        &self,
        guidance: &Guidance,
        point: &GuidePoint,
        normal: Vec3,
        wi: Vec3,
    ) -> GuidedDensity {
        match guidance.mode {
            GuideMode::Octant => {
                let cosine = pdf_cosine(normal.dot(wi));
                octants::density(&point.cell, point.mean, point.proposed, cosine, wi)
            }
            GuideMode::Adaptive => adaptive::density(guidance.table, &point.cell, wi),
            _ => GuidedDensity { pdf: 0.0, slot: 8 * point.cell.index + octant_of(wi) },
        }
    }

    /// Density with which [`Transport::guided_direction`] chooses `wi`, the material's delta part counted off.
    #[inline]
    pub fn guided_pdf(&self, point: &GuidePoint, normal: Vec3, wi: Vec3) -> f32 {
        let Some(guidance) = self.guidance else { return 0.0 };
        if guidance.mode == GuideMode::BansalReweighted {
            return point.share * bansal::pdf(&point.cell, guidance.table.uniforms.threshold, normal, wi);
        }
        let cosine = pdf_cosine(normal.dot(wi));
        if guidance.mode.is_bansal() || point.mixture <= 0.0 {
            return point.share * cosine;
        }
        point.mixture_pdf(cosine, self.guide_density(&guidance, point, normal, wi).pdf)
    }

    /// The same, with the slot that learns what arrives from `wi`.
    #[inline]
    pub fn guided_density(&self, point: &GuidePoint, normal: Vec3, wi: Vec3) -> GuidedDensity {
        match self.guidance {
            Some(guidance) if point.place.cell != NO_CELL => {
                let GuidedDensity { pdf, slot } = self.guide_density(&guidance, point, normal, wi);
                let pdf = match guidance.mode.is_bansal() {
                    true => self.guided_pdf(point, normal, wi),
                    false => point.mixture_pdf(pdf_cosine(normal.dot(wi)), pdf),
                };
                GuidedDensity { pdf, slot }
            }
            _ => GuidedDensity { pdf: self.guided_pdf(point, normal, wi), slot: 0 },
        }
    }

    /// A direction for the Lambertian lobe, the guide's or the material's, and its density:
    /// [`Transport::guided_density`], found on the way.
    #[inline]
    pub fn guided_sample(
        &self,
        point: &GuidePoint,
        normal: Vec3,
        u: Vec2,
        draws: &Draws,
    ) -> (Vec3, GuidedDensity) {
        // While it teaches, the map tells the leaf, too.
        let informed = |g: &Guidance| g.mode == GuideMode::Adaptive && g.table.uniforms.learning == 0;
        if let Some(guidance) = self.guidance.filter(informed)
            && u.x < point.mixture
        {
            let u = Vec2::new(u.x / point.mixture, u.y);
            let (wi, guided) = adaptive::sample(guidance.table, &point.cell, u);
            let pdf = point.mixture_pdf(pdf_cosine(normal.dot(wi)), guided);
            return (wi, GuidedDensity { pdf, slot: 0 });
        }
        let wi = self.guided_direction(point, normal, u, draws);
        (wi, self.guided_density(point, normal, wi))
    }

    /// The direction by itself. Its density is [`Transport::guided_pdf`].
    #[inline]
    pub fn guided_direction(&self, point: &GuidePoint, normal: Vec3, u: Vec2, draws: &Draws) -> Vec3 {
        let Some(guidance) = self.guidance else { return normal };
        match guidance.mode {
            GuideMode::Adaptive if u.x < point.mixture => {
                let u = Vec2::new(u.x / point.mixture, u.y);
                return adaptive::sample(guidance.table, &point.cell, u).0;
            }
            GuideMode::Octant => return octant_direction(point, normal, u, draws),
            mode if mode.is_bansal() => {
                return redrawn_direction(point, guidance.table.uniforms.threshold, normal, u, draws);
            }
            _ => {}
        }
        own_direction(own_numbers(guidance.mode, point, u), normal)
    }

    /// Counts the visit of a path that leaves at an angle of that cosine with that density, and gives the weight that
    /// radiance from there has. Adaptive cells learn irradiance: a visit counts 1, by eighths of the cell, which says
    /// where to cut it. Octants learn mean radiance, weighted by the cosine: a visit counts its weight.
    #[inline]
    pub fn visit(
        &self,
        point: &GuidePoint,
        cosine: f32,
        density: GuidedDensity,
        transition: &mut Transition,
    ) -> f32 {
        let Some(guidance) = self.guidance else { return 0.0 };
        transition.visit = 1.0;
        if point.place.cell == NO_CELL {
            transition.visited = MISSING | point.place.base;
            return 0.0;
        }
        let weight = if density.pdf > 0.0 { point.share * cosine.max(0.0) / density.pdf } else { 0.0 };
        match guidance.mode {
            GuideMode::Adaptive => transition.visited = 8 * point.place.cell + point.place.eighth,
            GuideMode::Octant => (transition.visited, transition.visit) = (density.slot, weight),
            _ => {
                transition.visited = density.slot;
                return 1.0;
            }
        }
        weight
    }

    /// What the surface is worth to the one before, beyond what it emits and what direct light brings: its albedo times
    /// the mean radiance that it has learnt; for Bansal a share of its best Q.
    #[inline]
    pub fn learnt_radiance(&self, point: &GuidePoint, material: &Material) -> f32 {
        match self.guidance {
            Some(guidance) if guidance.mode.is_bansal() => {
                (guidance.table.uniforms.discount * bansal::best(&point.cell)).min(1.0)
            }
            _ => luminance(material.color) * point.share * point.mean,
        }
    }
}

/// The material's own choice.
#[inline]
fn own_direction(own: Vec2, normal: Vec3) -> Vec3 {
    to_world(sample_cosine(own), normal)
}

/// Its numbers. One pair decides all: strips of the unit square choose who guides, and by which ticket or octant, so directions are
/// as evenly spread as the pair is over the samples of a pixel.
#[inline]
fn own_numbers(mode: GuideMode, point: &GuidePoint, u: Vec2) -> Vec2 {
    let x = match mode {
        GuideMode::Adaptive | GuideMode::Octant => {
            ((u.x - point.mixture) / (1.0 - point.mixture)).min(BELOW_ONE)
        }
        _ => u.x,
    };
    Vec2::new(x, u.y)
}

/// What the octants propose; where the horizon turns that down, and where the material is to choose, its own choice.
#[inline]
fn octant_direction(point: &GuidePoint, normal: Vec3, u: Vec2, draws: &Draws) -> Vec3 {
    let mut own = own_numbers(GuideMode::Octant, point, u);
    if u.x < point.mixture {
        let u = Vec2::new(u.x / point.mixture, u.y);
        let proposal = octants::proposal(&point.cell, normal, point.proposed, u);
        let accepted = acceptance(normal, proposal);
        if accepted.kept >= accepted.proposed {
            return proposal;
        }
        let next = draws.get(1);
        if next.x * accepted.proposed < accepted.kept {
            return proposal;
        }
        own = next.yz();
    }
    own_direction(own, normal)
}

/// Bansal's rule.
#[inline]
fn redrawn_direction(point: &GuidePoint, threshold: f32, normal: Vec3, u: Vec2, draws: &Draws) -> Vec3 {
    let mut wi = to_world(sample_cosine(u), normal);
    for draw in 1..bansal::DRAWS {
        if bansal::accepts(&point.cell, threshold, octant_of(wi)) {
            break;
        }
        wi = to_world(sample_cosine(draws.get(draw).xy()), normal);
    }
    wi
}
