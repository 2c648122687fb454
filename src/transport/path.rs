//! What happens to a path at each event. Pure functions: engines move the data, these do the transport.
//! GPU twin: kernels/transport/path.wesl

use super::guide::{Guidance, GuidePoint};
use super::items::{RayItem, ShadowItem};
use super::light::{LightChoice, choose_light, light_probability, pdf_light, sample_light};
use super::roulette::Roulette;
use super::split::{SEED_SHIFT, Share, bounce_of, budget_of, copies_of, pack_bounce, share_of};
use crate::accel::Search;
use crate::bsdf::{BsdfSample, bsdf_evaluate, bsdf_sample, is_black};
use crate::guiding::octant::Draws;
use crate::guiding::table::GuidedDensity;
use crate::guiding::{Trail, Transition};
use crate::math::{luminance, mis_weight};
use crate::random::{DIMENSION_CAMERA, SampleKey, Sampler, dimension_bsdf, dimension_light, sample4};
use crate::sampling::pdf_cosine;
use crate::scene::camera::camera_ray;
use crate::scene::compiled::{
    CompiledScene, KIND_DIELECTRIC, KIND_MIRROR, KIND_ROUGH_DIELECTRIC, Material, NONE, Uniforms,
};
use crate::scene::shading::{keeps_side, viewed_normal};
use crate::scene::shapes::{Hit, Ray, Surface, T_MISS, shape_info, spawn_ray, surface_at, uv_at};
use crate::scene::sky::{sample_sky, sky_at};
use crate::scene::texels::{textured, textured_emission};
use glam::{Vec2, Vec3, Vec4, Vec4Swizzles};

/// Everything a stage function may read: the scene, the numbers of the frame, the choice of estimators.
#[derive(Clone, Copy, Debug)]
pub struct Transport<'a> {
    pub scene: &'a CompiledScene,
    /// What finds its shapes.
    pub search: &'a Search<'a>,
    pub uniforms: &'a Uniforms,
    pub sampler: Sampler,
    /// Next-event estimation, combined with BSDF sampling; needs a light or an environment map.
    pub direct_light: bool,
    pub roulette: Roulette,
    /// Places that a path has for its radiance: how many copies learnt roulette may make of it. Usually 1.
    pub places: u32,
    /// What was learnt; None with guiding and learnt roulette off.
    pub guidance: Option<Guidance<'a>>,
}

/// Throughput below which a path ends, 2⁻¹⁰⁰: what it could still bring is less than any f32 sum shows, and quotients of
/// numbers near the end of f32's range are not to be trusted on every GPU.
pub const LEAST_THROUGHPUT: f32 = 7.888_609e-31;

/// What shading decides at one hit.
#[derive(Clone, Debug, Default)]
pub struct ShadeOutcome {
    /// Radiance that this hit itself emits towards the camera, times throughput.
    pub emitted: Vec3,
    /// If nothing is in its way, its radiance counts.
    pub shadow: Option<ShadowItem>,
    /// The path goes on with this ray, the first of its copies if it is `split`.
    pub ray: Option<RayItem>,
    /// What it remembers of this surface.
    pub trail: Trail,
    /// Boxed, since few paths are split.
    pub split: Option<Box<Split>>,
    /// What is learnt here, but for the shadow ray.
    pub transition: Transition,
    /// What the transition's slot learns besides if nothing is in the shadow ray's way.
    pub shadow_value: f32,
}

/// Where a path leaves a surface, and what is known there.
#[derive(Clone, Copy, Debug)]
pub struct Departure<'a> {
    /// As it arrived.
    ray: &'a RayItem,
    trail: &'a Trail,
    surface: &'a Surface,
    material: &'a Material,
    /// On the side from which the ray came: the shading normal, where there is one.
    normal: Vec3,
    outside: bool,
    point: Option<&'a GuidePoint>,
}

impl Departure<'_> {
    /// The shape's normal, on the side from which the ray came.
    #[inline(always)]
    fn facing(&self) -> Vec3 {
        if self.outside { self.surface.normal } else { -self.surface.normal }
    }
}

/// The shape's normal, on the side from which the ray came.
#[inline(always)]
fn facing_normal(ray: &RayItem, surface: &Surface) -> Vec3 {
    if ray.direction.dot(surface.normal) < 0.0 { surface.normal } else { -surface.normal }
}

/// A path that goes on as several copies: [`Transport::copy_of`] makes those but the first, from where it leaves.
#[derive(Clone, Copy, Debug)]
pub struct Split {
    ray: RayItem,
    trail: Trail,
    surface: Surface,
    material: Material,
    normal: Vec3,
    outside: bool,
    point: Option<GuidePoint>,
    /// How many were expected.
    survival: f32,
    pub copies: u32,
}

impl Split {
    fn at(&self) -> Departure<'_> {
        let Split { ray, trail, surface, material, normal, outside, point, .. } = self;
        let (normal, outside, point) = (*normal, *outside, point.as_ref());
        Departure { ray, trail, surface, material, normal, outside, point }
    }
}

/// Where a shadow ray ends, as a share of the distance to the light: 1 − 2⁻²⁰, so that a surface in which a lamp lies
/// flush does not shade it by rounding.
pub const SHADOW_END: f32 = 1.0 - 1.0 / 1_048_576.0;

impl<'a> Transport<'a> {
    /// Independent samples, no direct light, roulette by throughput, no guide.
    pub fn plain(scene: &'a CompiledScene, search: &'a Search<'a>, uniforms: &'a Uniforms) -> Transport<'a> {
        Transport {
            scene,
            search,
            uniforms,
            sampler: Sampler::Independent,
            direct_light: false,
            roulette: Roulette::Throughput,
            places: 1,
            guidance: None,
        }
    }
}

impl<'a> Transport<'a> {
    /// Paths of a batch are numbered sample by sample, pixel by pixel; each has all its places in a row.
    #[inline(always)]
    pub fn sample_key(&self, place: u32) -> SampleKey {
        let path = if self.places == 1 { place } else { place / self.places };
        let sample = path / self.uniforms.pixel_count;
        let pixel = path - sample * self.uniforms.pixel_count;
        SampleKey {
            pixel: self.uniforms.first_pixel + pixel,
            sample: self.uniforms.first_sample + sample,
            seed: self.uniforms.seed ^ (place - path * self.places) << SEED_SHIFT,
        }
    }

    /// The camera ray with which `path` starts; all the places of the path are its own.
    #[inline(always)]
    pub fn generate(&self, path: u32) -> RayItem {
        let place = path * self.places;
        let key = self.sample_key(place);
        let u = sample4(self.sampler, key, DIMENSION_CAMERA);
        let row = key.pixel / self.uniforms.width;
        let column = key.pixel - row * self.uniforms.width;
        let ray = camera_ray(self.uniforms, [column, row], u.xy());
        RayItem {
            origin: ray.origin,
            path: place,
            direction: ray.direction,
            bounce: pack_bounce(0, self.places),
            throughput: Vec3::ONE,
            pdf: 0.0,
        }
    }

    /// Radiance from where a ray goes that left the scene. Direct light may have found it too, as in [`Self::emission`].
    #[inline]
    fn environment_radiance(&self, ray: &RayItem) -> Vec3 {
        let Some(sky) = &self.scene.sky else { return self.uniforms.environment };
        let met = sky_at(sky, ray.direction);
        if self.direct_light && ray.pdf > 0.0 {
            return met.radiance * mis_weight(ray.pdf, self.uniforms.environment_share * met.pdf);
        }
        met.radiance
    }

    /// Light of the environment that such a ray brings.
    #[inline]
    pub fn environment(&self, ray: &RayItem) -> Vec3 {
        ray.throughput * self.environment_radiance(ray)
    }

    /// What it teaches the slot of its trail.
    #[inline]
    pub fn environment_value(&self, ray: &RayItem, trail: &Trail) -> f32 {
        luminance(self.environment_radiance(ray)) * trail.weight
    }

    /// Radiance that the surface itself sends back along the ray. Direct-light sampling could have found it too, unless
    /// the ray came from the camera or a delta lobe (pdf = 0), so it shares the contribution by multiple importance
    /// sampling.
    #[inline(always)]
    fn emission(&self, ray: &RayItem, hit: Hit, surface: &Surface, material: &Material) -> Vec3 {
        if ray.direction.dot(surface.normal) >= 0.0 || material.emission.max_element() <= 0.0 {
            return Vec3::ZERO;
        }
        let mut weight = 1.0;
        if self.direct_light && ray.pdf > 0.0 {
            let light = shape_info(self.scene, hit.shape).light;
            if light != NONE {
                let pdf = light_probability(self.scene, ray.origin, light)
                    * pdf_light(self.scene, ray.origin, hit.shape, ray.direction, hit.t)
                    * (1.0 - self.uniforms.environment_share);
                weight = mis_weight(ray.pdf, pdf);
            }
        }
        material.emission * weight
    }

    /// Direct light from the environment map: by chance `u.w`, which below the share of the map is as good as new.
    #[inline(always)]
    fn sky_light(
        &self,
        ray: &RayItem,
        surface: &Surface,
        (normal, facing): (Vec3, Vec3),
        material: &Material,
        u: Vec4,
    ) -> Option<ShadowItem> {
        let share = self.uniforms.environment_share;
        let towards = sample_sky(self.scene, Vec4::new(u.x, u.y, u.z, u.w / share));
        if towards.pdf <= 0.0 || !keeps_side(normal, facing, towards.wi) {
            return None;
        }
        let outside = ray.direction.dot(surface.normal) < 0.0;
        let bsdf = bsdf_evaluate(material, normal, -ray.direction, outside, towards.wi);
        if bsdf.value.max_element() <= 0.0 {
            return None;
        }
        let pdf = share * towards.pdf;
        Some(ShadowItem {
            origin: spawn_ray(surface, towards.wi).origin,
            t_max: T_MISS,
            direction: towards.wi,
            path: ray.path,
            radiance: bsdf.value * towards.radiance * (mis_weight(pdf, bsdf.pdf) / pdf),
            light_shape: NONE,
        })
    }

    /// Direct light from a lamp. What `u.w` has above the map's share chooses among many.
    #[inline(always)]
    fn lamp_light(
        &self,
        ray: &RayItem,
        surface: &Surface,
        (normal, facing): (Vec3, Vec3),
        material: &Material,
        u: Vec4,
    ) -> Option<ShadowItem> {
        // The point that the continued ray will leave from, so that both strategies measure the light from the same place.
        let mut origin = spawn_ray(surface, facing).origin;
        let share = 1.0 - self.uniforms.environment_share;
        let draws = Vec2::new(u.x, (u.w - self.uniforms.environment_share) / share);
        let both_sides = material.kind == KIND_ROUGH_DIELECTRIC;
        let lit_side = if both_sides { Vec3::ZERO } else { normal };
        let choice = choose_light(self.scene, origin, lit_side, draws);
        let LightChoice { light, mut weighing, .. } = choice;
        let mut towards = sample_light(self.scene, origin, light.shape, u.yz());
        if both_sides && towards.wi.dot(facing) < 0.0 {
            // Through the surface it leaves from its other side.
            origin = spawn_ray(surface, -facing).origin;
            towards = sample_light(self.scene, origin, light.shape, u.yz());
            weighing = light_probability(self.scene, origin, shape_info(self.scene, light.shape).light);
        }
        let pdf = share * choice.probability * towards.pdf;
        if pdf <= 0.0 || !keeps_side(normal, facing, towards.wi) {
            return None;
        }
        let outside = ray.direction.dot(surface.normal) < 0.0;
        let bsdf = bsdf_evaluate(material, normal, -ray.direction, outside, towards.wi);
        if bsdf.value.max_element() <= 0.0 {
            return None;
        }
        let emission = match self.scene.surfaces.textured_lamps {
            false => self.scene.materials[light.material as usize].emission,
            true => {
                let lit = uv_at(self.scene, light.shape, origin + towards.wi * towards.t);
                textured_emission(self.scene, light.material, lit)
            }
        };
        let weight = mis_weight(share * weighing * towards.pdf, bsdf.pdf);
        Some(ShadowItem {
            origin,
            t_max: towards.t * SHADOW_END,
            direction: towards.wi,
            path: ray.path,
            radiance: bsdf.value * emission * (weight / pdf),
            light_shape: light.shape,
        })
    }

    /// Next-event estimation: one light, one direction, to be tested for occlusion. None where nothing can arrive. Its
    /// radiance is what arrives at this surface's viewer, throughput not included.
    #[inline(always)]
    fn direct_light(
        &self,
        ray: &RayItem,
        surface: &Surface,
        normal: Vec3,
        material: &Material,
        key: SampleKey,
    ) -> Option<ShadowItem> {
        let u = sample4(self.sampler, key, dimension_light(bounce_of(ray)));
        let facing = facing_normal(ray, surface);
        match u.w < self.uniforms.environment_share {
            true => self.sky_light(ray, surface, (normal, facing), material, u),
            false => self.lamp_light(ray, surface, (normal, facing), material, u),
        }
    }

    /// The direction in which the path would go on, chosen by the material, or by the guide among what its Lambertian
    /// lobe may choose; and what the guide says of that.
    ///
    /// The sample's density is the material's own, which is what weights emission against direct light: any density does
    /// that without bias if both sides use the same, and this one costs no look-up for the directions of lights.
    #[inline(always)]
    fn scatter(&self, at: &Departure, key: SampleKey, u: Vec4) -> (BsdfSample, Option<GuidedDensity>) {
        let Departure { ray, material, normal, outside, .. } = *at;
        let mirrored = material.kind == KIND_MIRROR && u.z < material.parameter;
        let Some(point) = at.point.filter(|_| !mirrored) else {
            return (bsdf_sample(material, normal, -ray.direction, outside, u.xyz()), None);
        };
        let draws = Draws { sampler: self.sampler, key, bounce: bounce_of(ray) };
        let (wi, density) = self.guided_sample(point, normal, u.xy(), &draws);
        let pdf = point.share * pdf_cosine(normal.dot(wi));
        let weight = if density.pdf > 0.0 { material.color * (pdf / density.pdf) } else { Vec3::ZERO };
        (BsdfSample { wi, weight, pdf }, Some(density))
    }

    /// What a path that leaves in that direction remembers; a visit to the cell is noted in `transition`.
    fn leave_trail(
        &self,
        at: &Departure,
        scattered: &BsdfSample,
        density: Option<GuidedDensity>,
        survival: f32,
        transition: &mut Transition,
    ) -> Trail {
        match (at.point, density) {
            (Some(point), Some(density)) => {
                let weight = self.visit(point, at.normal.dot(scattered.wi), density, transition);
                Trail { slot: density.slot, weight: weight / survival, ..Default::default() }
            }
            _ => Trail { weight: at.trail.weight * luminance(scattered.weight) / survival, ..*at.trail },
        }
    }

    /// The ray with which a path goes on in that direction, with these places; None if nothing can come of it.
    fn go_on(&self, at: &Departure, scattered: &BsdfSample, survival: f32, own: Share) -> Option<RayItem> {
        let carried = at.ray.throughput * scattered.weight;
        if carried.max_element() <= LEAST_THROUGHPUT {
            return None;
        }
        if !keeps_side(at.normal, at.facing(), scattered.wi) {
            return None;
        }
        let next = spawn_ray(at.surface, scattered.wi);
        Some(RayItem {
            origin: next.origin,
            path: own.place,
            direction: next.direction,
            bounce: pack_bounce(bounce_of(at.ray) + 1, own.budget),
            throughput: carried / survival,
            pdf: scattered.pdf,
        })
    }

    /// Whether a ray comes from the outer side of a surface, and the normal by which the material answers, on the ray's side.
    #[inline(always)]
    fn viewed(&self, ray: &RayItem, surface: &Surface, material: &Material) -> (bool, Vec3) {
        let outside = ray.direction.dot(surface.normal) < 0.0;
        let facing = if outside { surface.normal } else { -surface.normal };
        match self.scene.surfaces.bends_normals() {
            false => (outside, facing),
            true => (outside, viewed_normal(surface, facing, outside, -ray.direction, material.kind)),
        }
    }

    /// Everything that happens where a ray meets a surface.
    #[inline(always)]
    pub fn shade(&self, ray: &RayItem, trail: &Trail, hit: Hit) -> ShadeOutcome {
        let mut surface = surface_at(self.scene, Ray { origin: ray.origin, direction: ray.direction }, hit);
        let index = shape_info(self.scene, hit.shape).material;
        let own;
        let material = match self.scene.surfaces.is_textured() {
            false => &self.scene.materials[index as usize],
            true => {
                own = textured(self.scene, index, &mut surface);
                &own
            }
        };
        let emission = self.emission(ray, hit, &surface, material);
        let mut outcome = ShadeOutcome { emitted: ray.throughput * emission, ..Default::default() };
        outcome.transition =
            Transition { slot: trail.slot, value: luminance(emission) * trail.weight, ..Default::default() };
        let bounce = bounce_of(ray);
        if bounce + 1 >= self.uniforms.max_bounces || is_black(material) {
            return outcome;
        }

        let key = self.sample_key(ray.path);
        let (outside, normal) = self.viewed(ray, &surface, material);
        let point = self.guide_point(&surface, normal, material);
        let point = point.as_ref();
        if let Some(point) = point {
            outcome.transition.value += self.learnt_radiance(point, material) * trail.weight;
        }
        if self.direct_light && material.kind != KIND_DIELECTRIC {
            outcome.shadow = self.direct_light(ray, &surface, normal, material, key);
            if let Some(shadow) = &mut outcome.shadow {
                outcome.shadow_value = luminance(shadow.radiance) * trail.weight;
                shadow.radiance *= ray.throughput;
            }
        }

        let at = Departure { ray, trail, surface: &surface, material, normal, outside, point };
        let u = sample4(self.sampler, key, dimension_bsdf(bounce));
        let (scattered, density) = self.scatter(&at, key, u);
        let throughput = ray.throughput * scattered.weight;
        let survival = self.roulette_survival(ray, throughput, material, point, key);
        outcome.trail = self.leave_trail(&at, &scattered, density, survival, &mut outcome.transition);
        let copies = copies_of(survival, u.w);
        if copies > 0 {
            let whole = Share { place: ray.path, budget: budget_of(ray) };
            outcome.ray = self.go_on(&at, &scattered, survival, share_of(whole, copies, 0));
        }
        if copies > 1 {
            let (ray, trail, material, point) = (*ray, *trail, *material, point.copied());
            let split = Split { ray, trail, surface, material, normal, outside, point, survival, copies };
            outcome.split = Some(Box::new(split));
        }
        outcome
    }

    /// The copy of that number of a path that was split, and what it remembers; 0 is the one that `shade` made. It chooses
    /// a direction of its own. The visit to the cell was counted with the first.
    pub fn copy_of(&self, split: &Split, copy: u32) -> Option<(RayItem, Trail)> {
        let (at, ray) = (split.at(), &split.ray);
        let own = share_of(Share { place: ray.path, budget: budget_of(ray) }, split.copies, copy);
        let key = self.sample_key(own.place);
        let u = sample4(self.sampler, key, dimension_bsdf(bounce_of(ray)));
        let (scattered, density) = self.scatter(&at, key, u);
        let trail = self.leave_trail(&at, &scattered, density, split.survival, &mut Transition::default());
        self.go_on(&at, &scattered, split.survival, own).map(|ray| (ray, trail))
    }
}
