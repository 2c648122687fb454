//! Eight shapes at a time. The same arithmetic as [`crate::scene::shapes`], lane by lane and bit for bit (a test holds it to
//! that), laid out so that the compiler turns it into vector instructions: AVX2 where the processor has it.

use crate::scene::compiled::{CompiledScene, Quad, Sphere};
use crate::scene::shapes::{Hit, Ray, T_MISS};

const LANES: usize = 8;
type Lane = [f32; LANES];

#[derive(Clone, Debug)]
#[repr(align(32))]
struct SphereBlock {
    center: [Lane; 3],
    radius: Lane,
}

#[derive(Clone, Debug)]
#[repr(align(32))]
struct QuadBlock {
    corner: [Lane; 3],
    normal: [Lane; 3],
    dual1: [Lane; 3],
    dual2: [Lane; 3],
}

/// All shapes of a scene in blocks of eight, spheres first. Lanes that no shape fills are never hit.
#[derive(Clone, Debug, Default)]
pub struct ShapeLanes {
    spheres: Vec<SphereBlock>,
    quads: Vec<QuadBlock>,
    first_quad: u32,
}

/// The values of one lane array, taken from up to eight shapes; `fill` in the rest.
fn gather<T>(shapes: &[T], fill: f32, value: impl Fn(&T) -> f32) -> Lane {
    std::array::from_fn(|i| shapes.get(i).map_or(fill, &value))
}

fn gather3<T>(shapes: &[T], value: impl Fn(&T) -> glam::Vec3) -> [Lane; 3] {
    std::array::from_fn(|axis| gather(shapes, 0.0, |shape| value(shape)[axis]))
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    // In glam's order, so that lanes round as scalars do.
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn lane(v: &[Lane; 3], i: usize) -> [f32; 3] {
    [v[0][i], v[1][i], v[2][i]]
}

impl SphereBlock {
    /// [`crate::scene::shapes::intersect_sphere`] for every lane. A radius that is no number is never hit.
    #[inline(always)]
    fn distances(&self, origin: [f32; 3], direction: [f32; 3]) -> Lane {
        std::array::from_fn(|i| {
            let center = lane(&self.center, i);
            let f: [f32; 3] = std::array::from_fn(|k| origin[k] - center[k]);
            let b = -dot(f, direction);
            let approach: [f32; 3] = std::array::from_fn(|k| f[k] + direction[k] * b);
            let discriminant = self.radius[i] * self.radius[i] - dot(approach, approach);
            let root = discriminant.sqrt();
            let q = if b >= 0.0 { b + root } else { b - root };
            let other = (dot(f, f) - self.radius[i] * self.radius[i]) / q;
            let (near, far) = (q.min(other), q.max(other));
            let t = if near > 0.0 { near } else { far };
            if (discriminant >= 0.0) & (t > 0.0) { t } else { T_MISS }
        })
    }
}

impl QuadBlock {
    /// [`crate::scene::shapes::intersect_quad`] for every lane. A normal of zero is never hit.
    #[inline(always)]
    fn distances(&self, origin: [f32; 3], direction: [f32; 3]) -> Lane {
        std::array::from_fn(|i| {
            let (corner, normal) = (lane(&self.corner, i), lane(&self.normal, i));
            let from_corner: [f32; 3] = std::array::from_fn(|k| origin[k] - corner[k]);
            let t = -dot(normal, from_corner) / dot(normal, direction);
            let p: [f32; 3] = std::array::from_fn(|k| from_corner[k] + direction[k] * t);
            let (a, b) = (dot(p, lane(&self.dual1, i)), dot(p, lane(&self.dual2, i)));
            // Without branches: `contains` compiles to one and is slower.
            #[expect(clippy::manual_range_contains)]
            let inside = (a >= 0.0) & (a <= 1.0) & (b >= 0.0) & (b <= 1.0);
            if inside & (t > 0.0) { t } else { T_MISS }
        })
    }
}

impl ShapeLanes {
    pub fn new(scene: &CompiledScene) -> ShapeLanes {
        let sphere_block = |s: &[Sphere]| SphereBlock {
            center: gather3(s, |s| s.center),
            radius: gather(s, f32::NAN, |s| s.radius),
        };
        let quad_block = |q: &[Quad]| QuadBlock {
            corner: gather3(q, |q| q.corner),
            normal: gather3(q, |q| q.normal),
            dual1: gather3(q, |q| q.dual1),
            dual2: gather3(q, |q| q.dual2),
        };
        ShapeLanes {
            spheres: scene.spheres.chunks(LANES).map(sphere_block).collect(),
            quads: scene.quads.chunks(LANES).map(quad_block).collect(),
            first_quad: scene.spheres.len() as u32,
        }
    }

    /// The nearest shape that the ray meets.
    pub fn intersect(&self, ray: Ray) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { self.intersect_avx2(ray) };
        }
        self.nearest(ray)
    }

    /// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
    pub fn occluded(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { self.occluded_avx2(ray, t_max, excluded) };
        }
        self.any_nearer(ray, t_max, excluded)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    unsafe fn intersect_avx2(&self, ray: Ray) -> Option<Hit> {
        self.nearest(ray)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    unsafe fn occluded_avx2(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        self.any_nearer(ray, t_max, excluded)
    }

    #[inline(always)]
    fn nearest(&self, ray: Ray) -> Option<Hit> {
        let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
        let mut hit = Hit { t: T_MISS, shape: u32::MAX };
        let mut first = 0;
        for block in &self.spheres {
            keep_nearest(&mut hit, &block.distances(origin, direction), first);
            first += LANES as u32;
        }
        let mut first = self.first_quad;
        for block in &self.quads {
            keep_nearest(&mut hit, &block.distances(origin, direction), first);
            first += LANES as u32;
        }
        (hit.shape != u32::MAX).then_some(hit)
    }

    #[inline(always)]
    fn any_nearer(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
        let blocks = |t: &Lane, first: u32| {
            t.iter()
                .enumerate()
                .fold(false, |any, (i, t)| any | ((*t < t_max) & (first + i as u32 != excluded)))
        };
        let mut first = 0;
        for block in &self.spheres {
            if blocks(&block.distances(origin, direction), first) {
                return true;
            }
            first += LANES as u32;
        }
        let mut first = self.first_quad;
        for block in &self.quads {
            if blocks(&block.distances(origin, direction), first) {
                return true;
            }
            first += LANES as u32;
        }
        false
    }
}

/// The first of the nearest lanes, if it is nearer than `hit`: the order in which a loop over the shapes would find it.
#[inline(always)]
fn keep_nearest(hit: &mut Hit, distances: &Lane, first: u32) {
    let nearest = distances.iter().fold(T_MISS, |a, &b| if b < a { b } else { a });
    if nearest < hit.t {
        let lane = distances.iter().position(|&t| t == nearest).unwrap_or(0);
        *hit = Hit { t: nearest, shape: first + lane as u32 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{SampleKey, Sampler, sample4};
    use crate::scene::Scene;
    use crate::scene::shapes::{intersect, occluded};
    use glam::Vec3;

    #[test]
    fn lanes_find_what_a_loop_over_the_shapes_finds_bit_for_bit() {
        for name in ["cornell-box", "bansal-room-1", "door-ajar", "many-lights", "glossy-box"] {
            let described = Scene::load(format!("scenes/{name}.toml")).unwrap();
            let scene = CompiledScene::new(&described);
            let lanes = ShapeLanes::new(&scene);
            let (eye, target) = (described.camera.origin.as_vec3(), described.camera.target.as_vec3());
            let size = (target - eye).length();
            let mut hits = 0;
            for i in 0..20_000 {
                let u = sample4(Sampler::Independent, SampleKey { pixel: i, sample: 1, seed: 3 }, 0);
                let v = sample4(Sampler::Independent, SampleKey { pixel: i, sample: 2, seed: 3 }, 0);
                let origin = eye.lerp(target, u.z);
                let direction = (Vec3::new(v.x, v.y, v.z) - 0.5).normalize();
                let ray = Ray { origin, direction };
                let hit = intersect(&scene, ray);
                assert_eq!(lanes.intersect(ray), hit, "{name}, ray {i}");
                hits += u32::from(hit.is_some());
                let (t_max, excluded) = (u.w * size, (v.w * 20.0) as u32);
                let expected = occluded(&scene, ray, t_max, excluded);
                assert_eq!(lanes.occluded(ray, t_max, excluded), expected, "{name}, ray {i}");
            }
            assert!(hits > 2_000, "{name}: only {hits} rays hit anything");
        }
    }
}
