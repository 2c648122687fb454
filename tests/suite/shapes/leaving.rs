//! Rays that leave surfaces: none meets what it left (acne), none starts behind it (a leak).

use super::quads::{QuadRange, some_quads};
use super::spheres::{SphereRange, some_spheres};
use super::tangent;
use super::twins::{Gone, Leaving, Twin, aimed, both_twins};
use crate::oracles::geometry::{Parallelogram, ROUNDING, chord, height_over_sphere, unit};
use crate::probe::{Numbers, floats};
use crate::support::quad_index;
use glam::Vec3;
use qtracer::scene::compiled::{CompiledScene, Sphere};
use qtracer::scene::shapes::T_MISS;

/// Rays of a batch: few enough for one buffer.
const BATCH: usize = 1 << 19;

/// What rays did that left shapes.
#[derive(Debug, Default)]
struct Left {
    outwards: u32,
    inwards: u32,
    /// Rays that started on the wrong side.
    leaked: u32,
    /// Rays that met what they left.
    acne: u32,
    /// Rays that missed what they should meet: the far side of a sphere, the quad behind them.
    lost: u32,
    /// Worst distance from the shape of a hit that was to be, in spawn offsets.
    worst_residual: f64,
    /// Worst relative error of the distance to a sphere's far side, where the cosine is above 0.1, and of all.
    worst_distance: [f64; 2],
    /// Worst relative deviation of a start's height over the shape from the offset.
    worst_height: f64,
    /// Worst distance of a hit point from the shape, in offsets.
    worst_point: f64,
}

impl Left {
    /// `count` rays that leave shapes of the scene from offsets `scale` times the used ones, one half outwards, cosines
    /// from 1e-7.
    fn add(&mut self, twin: &Twin, scene: &CompiledScene, seed: u64, count: usize, scale: f32) {
        let mut numbers = Numbers(seed);
        let shapes = scene.spheres.len() + scene.quads.len();
        let arrivals: Vec<_> = (0..count)
            .map(|i| {
                let (origin, direction) = arrival(&mut numbers, scene, i % shapes);
                aimed(origin, direction, i % shapes)
            })
            .collect();
        let met = twin.meet(scene, &arrivals);
        let hits = met.iter().enumerate().filter(|(_, met)| met.hit());
        let leaving: Vec<Leaving> = hits
            .map(|(i, met)| {
                let n = met.surface.normal.as_dvec3().normalize();
                let cos = numbers.sign() * numbers.of_any_size(1e-7, 1.0);
                let direction = unit(n * cos + tangent(&mut numbers, n) * (1.0 - cos * cos).sqrt());
                met.leaving((i % shapes) as u32, direction, scale)
            })
            .collect();
        assert!(leaving.len() > count * 9 / 10, "only {} of {count} rays arrived", leaving.len());
        for (question, gone) in leaving.iter().zip(twin.leave(scene, &leaving)) {
            match quad_index(scene, question[0][3]) {
                None => self.judge_sphere(&scene.spheres[question[0][3] as usize], question, gone),
                Some(i) => self.judge_quad(&Parallelogram::new(&scene.quads[i]), question, gone),
            }
        }
    }

    fn wrong(&self) -> u32 {
        self.leaked + self.acne + self.lost
    }

    /// Whether the ray started on the side that it leaves to. The program's cosine has the error of three products.
    fn judge_side(&mut self, height: f64, cos: f64) {
        self.leaked += u32::from((height > 0.0) != (cos >= 0.0) && cos.abs() >= 3.0 * ROUNDING);
    }

    fn judge_sphere(&mut self, sphere: &Sphere, question: &Leaving, gone: Gone) {
        let [(point, _), (n, offset), (direction, _)] = question.map(floats);
        let offset = f64::from(offset).max(f64::MIN_POSITIVE);
        let height = height_over_sphere(sphere, gone.origin, direction, 0.0);
        let cos = n.as_dvec3().dot(direction.as_dvec3());
        self.worst_point = self.worst_point.max(height_over_sphere(sphere, point, n, 0.0).abs() / offset);
        self.worst_height = self.worst_height.max((height.abs() / offset - 1.0).abs());
        self.judge_side(height, cos);
        if height > 0.0 {
            self.outwards += 1;
            self.acne += u32::from(gone.ahead < T_MISS);
            return;
        }
        self.inwards += 1;
        let (middle, half) = chord(gone.origin, direction, sphere.center, f64::from(sphere.radius));
        let off = height_over_sphere(sphere, gone.origin, direction, gone.ahead.into()).abs() / offset;
        if gone.ahead >= T_MISS {
            self.lost += 1;
        } else if f64::from(gone.ahead) <= middle || off > 1.0 {
            self.acne += 1;
        } else {
            let error = (f64::from(gone.ahead) / (middle + half) - 1.0).abs();
            self.worst_residual = self.worst_residual.max(off);
            self.worst_distance[0] = self.worst_distance[0].max(if cos < -0.1 { error } else { 0.0 });
            self.worst_distance[1] = self.worst_distance[1].max(error);
        }
    }

    fn judge_quad(&mut self, quad: &Parallelogram, question: &Leaving, gone: Gone) {
        let [(point, _), (n, offset), (direction, _)] = question.map(floats);
        let offset = f64::from(offset).max(f64::MIN_POSITIVE);
        // The program's normal may differ from the exact one by a rounding: its cosine decides.
        let height = quad.height(quad.at(gone.origin, direction, 0.0));
        let cos = n.as_dvec3().dot(direction.as_dvec3());
        self.worst_point = self.worst_point.max(quad.height(quad.at(point, n, 0.0)).abs() / offset);
        self.worst_height = self.worst_height.max((height.abs() / offset - 1.0).abs());
        self.judge_side(height, cos);
        *(if cos >= 0.0 { &mut self.outwards } else { &mut self.inwards }) += 1;
        self.acne += u32::from(gone.ahead < T_MISS);
        // What it left lies behind it, unless it left so flat that it passes the edge.
        let back = height.abs() / cos.abs();
        let band = offset / cos.abs();
        if quad.within(quad.at(gone.origin, direction, -back)) > band {
            if gone.behind >= T_MISS {
                self.lost += 1;
            } else {
                let off = quad.height(quad.at(gone.origin, -direction, gone.behind.into())).abs();
                self.worst_residual = self.worst_residual.max(off / offset);
            }
        }
    }
}

/// A ray that meets a shape, from anywhere.
fn arrival(numbers: &mut Numbers, scene: &CompiledScene, shape: usize) -> (Vec3, Vec3) {
    let (origin, target) = match quad_index(scene, shape as u32) {
        None => {
            let Sphere { center, radius, .. } = scene.spheres[shape];
            let (center, radius) = (center.as_dvec3(), f64::from(radius));
            let away = [numbers.between(0.0, 0.99), numbers.of_any_size(1.01, 1e3)][numbers.below(2)];
            let origin = (center + numbers.direction() * radius * away).as_vec3();
            (origin, center + numbers.direction() * radius * 0.999)
        }
        Some(i) => {
            let quad = Parallelogram::new(&scene.quads[i]);
            let mut inner = || numbers.between(0.05, 0.95);
            let target = quad.corner + quad.e1 * inner() + quad.e2 * inner();
            // Not so flat, and not from so far, that it misses by rounding.
            let size = quad.e1.length().min(quad.e2.length());
            let height = quad.normal * numbers.sign() * numbers.of_any_size(1.0, 30.0) * size;
            ((target + height + tangent(numbers, quad.normal) * size).as_vec3(), target)
        }
    };
    (origin, unit(target - origin.as_dvec3()))
}

type Shapes = fn() -> CompiledScene;

fn spheres_that_rays_leave() -> CompiledScene {
    some_spheres(4096, &SphereRange { radii: [1e-3, 1e6], places: [1e-3, 1e6], least_offsets: 10.0 })
}

fn quads_that_rays_leave() -> CompiledScene {
    some_quads(
        4096,
        &QuadRange { sides: [1e-3, 1e6], places: [1e-3, 1e6], least_offsets: 10.0, ..QuadRange::ANY },
    )
}

/// No ray of `batches` batches leaks, meets what it left or loses what it should meet.
fn rays_leave(twin: &Twin, shapes: Shapes, batches: u64) {
    let (scene, mut left) = (shapes(), Left::default());
    for seed in 0..batches {
        left.add(twin, &scene, 100 + seed, BATCH, 1.0);
    }
    println!("{}, {} spheres, {} quads: {left:?}", twin.name(), scene.spheres.len(), scene.quads.len());
    assert!(u64::from(left.outwards.min(left.inwards)) > batches * BATCH as u64 / 3);
    assert_eq!(left.wrong(), 0, "seeds 100 to {}: {left:?}", 100 + batches);
    assert!(left.worst_residual < 0.5 && left.worst_point < 0.5 && left.worst_height < 0.5, "{left:?}");
    // Negative control: without an offset, and with a sixteenth of it, rays are lost.
    for scale in [0.0, 1.0 / 16.0] {
        let mut lost = Left::default();
        lost.add(twin, &scene, 99, BATCH / 8, scale);
        println!("  {scale} offsets: {} wrong", lost.wrong());
        assert!(lost.wrong() > 30, "{scale}: {lost:?}");
    }
}

/// Outwards they never meet it again; inwards they meet its far side, less than half an offset off it. However grazing.
#[test]
fn rays_that_leave_a_sphere_outwards_never_meet_it_and_those_inwards_meet_its_far_side() {
    both_twins().iter().for_each(|twin| rays_leave(twin, spheres_that_rays_leave, 2));
}

/// Not on either side, however grazing; and it lies behind them.
#[test]
fn rays_that_leave_a_quad_never_meet_it_and_have_it_behind_them() {
    both_twins().iter().for_each(|twin| rays_leave(twin, quads_that_rays_leave, 2));
}

#[test]
#[ignore = "long: 100 million rays in the kernels; tests/run --long"]
fn a_hundred_million_rays_leave_spheres_rightly() {
    rays_leave(&both_twins()[0], spheres_that_rays_leave, 192);
}

#[test]
#[ignore = "long: 100 million rays in the kernels; tests/run --long"]
fn a_hundred_million_rays_leave_quads_rightly() {
    rays_leave(&both_twins()[0], quads_that_rays_leave, 192);
}

#[test]
#[ignore = "long: 200 million rays on the CPU; tests/run --long"]
fn a_hundred_million_rays_leave_spheres_and_quads_rightly_on_the_cpu() {
    for shapes in [spheres_that_rays_leave as Shapes, quads_that_rays_leave] {
        rays_leave(&Twin::Cpu, shapes, 192);
    }
}

/// Where the range ends: down to a radius of two offsets no ray is wrong, though rays from the smallest start half a radius
/// off; below one, rays start beyond the far side.
#[test]
fn spheres_are_left_rightly_down_to_two_offsets_of_radius_and_wrongly_below_one() {
    for twin in both_twins() {
        for offsets in [10.0, 5.0, 2.0, 0.5, 0.1] {
            let range = SphereRange { radii: [offsets; 2], places: [1e-3, 1e6], least_offsets: 0.0 };
            let mut left = Left::default();
            left.add(&twin, &range.in_offsets(4096), 1, BATCH / 8, 1.0);
            println!("{}, radius of {offsets} offsets: {left:?}", twin.name());
            let wrong = left.wrong() as usize;
            assert!(if offsets >= 2.0 { wrong == 0 } else { wrong > BATCH / 8 / 5 }, "{offsets}: {left:?}");
        }
    }
}
