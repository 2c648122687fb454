//! Eight shapes at a time. The same arithmetic as [`crate::scene::shapes`], lane by lane and bit for bit (a test holds it to
//! that), written once over [`Lanes`]: AVX2 where the processor has it, arrays elsewhere.

#[cfg(target_arch = "x86_64")]
use super::vector::{Avx2, has_avx2};
use super::vector::{LANES, Lane, LaneMask, Lanes};
use crate::scene::compiled::{CompiledScene, Quad, Sphere};
use crate::scene::shapes::{Hit, Ray, T_MISS};
use glam::Vec3;

#[derive(Clone, Debug)]
struct SphereBlock {
    center: [Lane; 3],
    radius: Lane,
}

#[derive(Clone, Debug)]
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
    Lane(std::array::from_fn(|i| shapes.get(i).map_or(fill, &value)))
}

fn gather3<T>(shapes: &[T], value: impl Fn(&T) -> Vec3) -> [Lane; 3] {
    std::array::from_fn(|axis| gather(shapes, 0.0, |shape| value(shape)[axis]))
}

#[inline(always)]
fn splat3<L: Lanes>(v: Vec3) -> [L; 3] {
    [L::splat(v.x), L::splat(v.y), L::splat(v.z)]
}

#[inline(always)]
fn load3<L: Lanes>(v: &[Lane; 3]) -> [L; 3] {
    [L::load(&v[0]), L::load(&v[1]), L::load(&v[2])]
}

#[inline(always)]
fn sub3<L: Lanes>(a: [L; 3], b: [L; 3]) -> [L; 3] {
    [a[0].sub(b[0]), a[1].sub(b[1]), a[2].sub(b[2])]
}

/// a + b · s
#[inline(always)]
fn along<L: Lanes>(a: [L; 3], b: [L; 3], s: L) -> [L; 3] {
    [a[0].add(b[0].mul(s)), a[1].add(b[1].mul(s)), a[2].add(b[2].mul(s))]
}

#[inline(always)]
fn dot<L: Lanes>(a: [L; 3], b: [L; 3]) -> L {
    // In glam's order, so that lanes round as scalars do.
    a[0].mul(b[0]).add(a[1].mul(b[1])).add(a[2].mul(b[2]))
}

/// One ray in every lane.
#[derive(Clone, Copy)]
struct LaneRay<L> {
    origin: [L; 3],
    direction: [L; 3],
}

impl<L: Lanes> LaneRay<L> {
    #[inline(always)]
    fn new(ray: Ray) -> Self {
        LaneRay { origin: splat3(ray.origin), direction: splat3(ray.direction) }
    }
}

trait Block {
    /// Distance along the ray to every lane's shape, [`T_MISS`] if it is not met.
    fn distances<L: Lanes>(&self, ray: &LaneRay<L>) -> L;
}

impl Block for SphereBlock {
    /// [`crate::scene::shapes::intersect_sphere`] for every lane. A radius that is no number is never hit.
    #[inline(always)]
    fn distances<L: Lanes>(&self, ray: &LaneRay<L>) -> L {
        let (zero, radius) = (L::splat(0.0), L::load(&self.radius));
        let radius2 = radius.mul(radius);
        let f = sub3(ray.origin, load3(&self.center));
        let b = dot(f, ray.direction).neg();
        let approach = along(f, ray.direction, b);
        let discriminant = radius2.sub(dot(approach, approach));
        let root = discriminant.sqrt();
        let q = L::select(zero.le(b), b.add(root), b.sub(root));
        let other = dot(f, f).sub(radius2).div(q);
        let (near, far) = (other.min(q), other.max(q));
        let t = L::select(zero.lt(near), near, far);
        L::select(zero.le(discriminant).and(zero.lt(t)), t, L::splat(T_MISS))
    }
}

impl Block for QuadBlock {
    /// [`crate::scene::shapes::intersect_quad`] for every lane. A normal of zero is never hit.
    #[inline(always)]
    fn distances<L: Lanes>(&self, ray: &LaneRay<L>) -> L {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let normal = load3(&self.normal);
        let from_corner = sub3(ray.origin, load3(&self.corner));
        let t = dot(normal, from_corner).neg().div(dot(normal, ray.direction));
        let p = along(from_corner, ray.direction, t);
        let (a, b) = (dot(p, load3(&self.dual1)), dot(p, load3(&self.dual2)));
        let inside = zero.le(a).and(a.le(one)).and(zero.le(b)).and(b.le(one));
        L::select(inside.and(zero.lt(t)), t, L::splat(T_MISS))
    }
}

/// The nearest shape so far, lane by lane. Shapes are numbered in f32, which is exact below 2²⁴.
#[derive(Clone, Copy)]
struct Nearest<L> {
    t: L,
    shape: L,
}

impl<L: Lanes> Nearest<L> {
    /// Shapes of `blocks`, the first of which is number `first`, if they are nearer.
    #[inline(always)]
    fn among(mut self, blocks: &[impl Block], first: u32, ray: &LaneRay<L>) -> Self {
        let mut shape = L::count_from(first as f32);
        for block in blocks {
            let t = block.distances(ray);
            let nearer = t.lt(self.t);
            self.t = L::select(nearer, t, self.t);
            self.shape = L::select(nearer, shape, self.shape);
            shape = shape.add(L::splat(LANES as f32));
        }
        self
    }

    /// The first of the nearest shapes: the one that a loop over the shapes would find.
    #[inline(always)]
    fn hit(self) -> Option<Hit> {
        let t = self.t.least();
        if t >= T_MISS {
            return None;
        }
        let none = L::splat(f32::INFINITY);
        let shape = L::select(self.t.le(L::splat(t)), self.shape, none).least();
        Some(Hit { t, shape: shape as u32 })
    }
}

/// Whether any shape of `blocks` but `excluded` lies nearer than `t_max`.
#[inline(always)]
fn any_nearer<L: Lanes>(
    blocks: &[impl Block],
    first: u32,
    ray: &LaneRay<L>,
    t_max: f32,
    excluded: u32,
) -> bool {
    let mut shape = L::count_from(first as f32);
    for block in blocks {
        let blocks = block.distances(ray).lt(L::splat(t_max)).and(shape.ne(L::splat(excluded as f32)));
        if blocks.any() {
            return true;
        }
        shape = shape.add(L::splat(LANES as f32));
    }
    false
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
    #[inline]
    pub fn intersect(&self, ray: Ray) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the processor has AVX2.
            return unsafe { self.intersect_avx2(ray) };
        }
        self.nearest::<Lane>(ray)
    }

    /// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
    #[inline]
    pub fn occluded(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the processor has AVX2.
            return unsafe { self.occluded_avx2(ray, t_max, excluded) };
        }
        self.any_nearer::<Lane>(ray, t_max, excluded)
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    fn intersect_avx2(&self, ray: Ray) -> Option<Hit> {
        self.nearest::<Avx2>(ray)
    }

    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    fn occluded_avx2(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        self.any_nearer::<Avx2>(ray, t_max, excluded)
    }

    #[inline(always)]
    fn nearest<L: Lanes>(&self, ray: Ray) -> Option<Hit> {
        let ray = LaneRay::<L>::new(ray);
        let nothing = Nearest { t: L::splat(T_MISS), shape: L::splat(f32::INFINITY) };
        nothing.among(&self.spheres, 0, &ray).among(&self.quads, self.first_quad, &ray).hit()
    }

    #[inline(always)]
    fn any_nearer<L: Lanes>(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        let ray = LaneRay::<L>::new(ray);
        any_nearer(&self.spheres, 0, &ray, t_max, excluded)
            || any_nearer(&self.quads, self.first_quad, &ray, t_max, excluded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{SampleKey, Sampler, sample4};
    use crate::scene::Scene;
    use crate::scene::shapes::{intersect, occluded};

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
