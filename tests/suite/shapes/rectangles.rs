//! Rectangles whose sides run along axes, which the kernels test in brief.

use super::{ask, empty, key};
use crate::oracles::geometry::{ROUNDING, unit};
use crate::probe::{Numbers, Probe, floats, row};
use crate::support::open_gpu;
use glam::{DVec3, Vec3};
use qtracer::gpu::device::Gpu;
use qtracer::scene::compiled::{CompiledScene, Quad};
use qtracer::scene::rows::{self, Row};
use qtracer::scene::shapes::T_MISS;

/// Twenty rectangles at right angles to each axis, of both windings, with sides of both signs.
fn some_rectangles(numbers: &mut Numbers, size: f64) -> CompiledScene {
    let mut builder = empty();
    for i in 0..60 {
        let mut side =
            |axis: usize| DVec3::AXES[axis % 3] * numbers.sign() * size * numbers.of_any_size(1e-2, 1.0);
        let (u, v) = (side(i + 1), side(i + 2));
        let corner = numbers.in_box(size);
        builder = match numbers.below(2) {
            0 => builder.quad(corner, u, v, "m"),
            _ => builder.quad(corner, v, u, "m"),
        };
    }
    let scene = CompiledScene::new(&builder.build().unwrap());
    assert_eq!(scene.aligned, [20; 3]);
    scene
}

const ALIGNED: (&str, &str) = (
    "import package::scene::data::{aligned_counts, aligned_test, quad_at, quad_count, NONE};
    import package::scene::shapes::{Hit, Ray, T_MISS, from_y, from_z, intersect, intersect_aligned, intersect_quad};",
    "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
    let quad = quad_at(a.w);
    let t = intersect_quad(ray, quad.corner, quad.normal, quad.dual1, quad.dual2);
    var turned = ray;
    if a.w >= aligned_counts().x { turned = from_y(ray); }
    if a.w >= aligned_counts().x + aligned_counts().y { turned = from_z(ray); }
    let brief = intersect_aligned(turned.origin, turned.direction, 1.0 / turned.direction.x, aligned_test(a.w));
    var all = Hit(T_MISS, NONE);
    for (var i = 0u; i < quad_count(); i++) {
        let other = quad_at(i);
        let distance = intersect_quad(ray, other.corner, other.normal, other.dual1, other.dual2);
        if distance < all.t { all = Hit(distance, i); }
    }
    let nearest = intersect(ray);
    out0 = vec4<u32>(bitcast<u32>(t), bitcast<u32>(brief), 0u, 0u);
    out1 = vec4<u32>(bitcast<u32>(all.t), all.shape, bitcast<u32>(nearest.t), nearest.shape);",
);

/// A ray at a rectangle, and whether it is parallel to its plane: to points in it and around it, to its edges, in its plane.
fn ray_at(numbers: &mut Numbers, quad: &Quad, size: f64) -> (Vec3, Vec3, bool) {
    let axis = quad.axis().unwrap();
    let share = |numbers: &mut Numbers| match numbers.below(4) {
        0 => [0.0, 1.0][numbers.below(2)] + numbers.sign() * numbers.of_any_size(1e-8, 1e-3),
        _ => numbers.between(-0.2, 1.2),
    };
    let (a, b) = (share(numbers), share(numbers));
    let target = quad.corner.as_dvec3() + quad.e1.as_dvec3() * a + quad.e2.as_dvec3() * b;
    let mut origin = target + numbers.direction() * size * numbers.of_any_size(1e-3, 10.0);
    let kind = numbers.below(8);
    if kind == 0 {
        origin[axis] = quad.corner[axis].into();
    }
    let origin = origin.as_vec3();
    let mut direction = target - origin.as_dvec3();
    let zero = |numbers: &mut Numbers| 0.0f64.copysign(numbers.sign());
    if kind <= 1 {
        direction[axis] = zero(numbers);
    }
    // One more component, or both others, exactly zero.
    if numbers.below(4) == 0 {
        direction[(axis + 1 + numbers.below(2)) % 3] = zero(numbers);
    }
    if numbers.below(16) == 0 {
        direction = DVec3::from_array([(); 3].map(|()| zero(numbers)));
        direction[numbers.below(3)] = numbers.sign();
    }
    let direction = unit(direction);
    (origin, direction, direction[axis] == 0.0)
}

/// In f64: the distance to the plane of a rectangle, and how far within it the ray passes, as a share of the sides, with the
/// share that `roundings` of the ray's length are.
fn inside(quad: &Quad, origin: Vec3, direction: Vec3, roundings: f64) -> (f64, f64, f64) {
    let [corner, e1, e2] = [quad.corner, quad.e1, quad.e2].map(|v| v.as_dvec3());
    let (f, d, axis) = (origin.as_dvec3() - corner, direction.as_dvec3(), quad.axis().unwrap());
    let t = -f[axis] / d[axis];
    let p = f + d * t;
    let [a, b] = [e1, e2].map(|e| p.dot(e) / e.length_squared());
    let length = f.abs().max_element() + t.abs();
    let share = roundings * ROUNDING * length / e1.length().min(e2.length());
    (t, a.min(1.0 - a).min(b).min(1.0 - b), share)
}

/// What brief tests gave for rectangles.
#[derive(Debug, Default)]
struct Aligned {
    hits: u32,
    parallel: u32,
    /// Hits of rays parallel to the plane, and distances that are none.
    impossible: u32,
    /// Hits and misses unlike those of the general test, or unlike those in f64, away from edges.
    unlike: u32,
    /// … and at edges.
    at_edges: u32,
    /// Nearest shapes that are others than asking all by the general test finds, away from edges.
    other_nearest: u32,
    /// Worst difference from the general test, in numbers between.
    worst_ulps: u32,
    /// Worst error against f64, in roundings of the distance.
    worst_error: f64,
}

impl Aligned {
    fn add(&mut self, gpu: &Gpu, seed: u64, size: f64, count: usize, change: impl Fn(&mut [Row])) {
        let mut numbers = Numbers(seed);
        let scene = some_rectangles(&mut numbers, size);
        let probe = Probe::<2, 2>::new(gpu, &key(&scene), ALIGNED.0, ALIGNED.1);
        let mut hot = rows::hot(&scene);
        change(&mut hot);
        let ray = |i: usize| {
            let (origin, direction, _) = ray_at(&mut numbers, &scene.quads[i % 60], size);
            [row(origin, (i % 60) as u32), row(direction, 0)]
        };
        let rays: Vec<_> = (0..count).map(ray).collect();
        for ([a, b], [one, [all_t, all, near_t, near]]) in
            rays.iter().zip(ask(gpu, &probe, &scene, &hot, &rays))
        {
            let (origin, direction) = (floats(*a).0, floats(*b).0);
            self.judge(&scene.quads[a[3] as usize], origin, direction, [one[0], one[1]].map(f32::from_bits));
            let at_edge = |shape: u32| {
                scene.quads.get(shape as usize).is_some_and(|quad| {
                    let (_, within, share) = inside(quad, origin, direction, 4.0);
                    within.abs() < 1e-6 + share
                })
            };
            let same = all == near && all_t.abs_diff(near_t) <= 2;
            self.other_nearest += u32::from(!same && !at_edge(all) && !at_edge(near));
        }
    }

    fn judge(&mut self, quad: &Quad, origin: Vec3, direction: Vec3, [general, brief]: [f32; 2]) {
        let hit = brief != T_MISS;
        self.impossible += u32::from(!brief.is_finite() || brief <= 0.0);
        if direction[quad.axis().unwrap()] == 0.0 {
            self.parallel += 1;
            self.impossible += u32::from(hit || general != T_MISS);
            return;
        }
        let (t, within, share) = inside(quad, origin, direction, 4.0);
        let right = t > 0.0 && within >= 0.0;
        let alike = hit == (general != T_MISS) && hit == right;
        if within.abs() < 1e-6 + share {
            self.at_edges += u32::from(!alike);
        } else {
            self.unlike += u32::from(!alike);
        }
        if hit && general != T_MISS {
            self.hits += 1;
            self.worst_ulps = self.worst_ulps.max(brief.to_bits().abs_diff(general.to_bits()));
            self.worst_error = self.worst_error.max((f64::from(brief) / t - 1.0).abs() / ROUNDING);
        }
    }
}

/// The brief test of rectangles along axes gives the hits and, to two units in the last place, the distances of the general
/// one, and both are right; rays parallel to a plane never meet it, nothing is NaN.
#[test]
fn rectangles_along_axes_are_met_as_other_quads_are() {
    let gpu = open_gpu();
    let mut aligned = Aligned::default();
    for seed in 0..4 {
        aligned.add(&gpu, seed, [1.0, 1e3, 1e-6, 1e6][seed as usize], 1 << 18, |_| ());
    }
    println!("{aligned:?}");
    assert!(aligned.hits > 200_000 && aligned.parallel > 100_000, "{aligned:?}");
    assert_eq!([aligned.impossible, aligned.unlike, aligned.other_nearest], [0; 3], "{aligned:?}");
    assert!(aligned.worst_ulps <= 2 && aligned.worst_error <= 4.0, "{aligned:?}");
    assert!(aligned.at_edges < aligned.hits / 10, "{aligned:?}");
    // Negative controls: a side, or a level, off by a ten thousandth.
    let scaled = |word: usize| {
        move |hot: &mut [Row]| {
            hot.iter_mut()
                .step_by(2)
                .for_each(|row| row[word] = (f32::from_bits(row[word]) * 1.0001).to_bits())
        }
    };
    for word in [3, 0] {
        let mut wrong = Aligned::default();
        wrong.add(&gpu, 0, 1.0, 1 << 16, scaled(word));
        assert!(wrong.unlike > 10 && wrong.other_nearest > 10, "{word}: {wrong:?}");
    }
}
