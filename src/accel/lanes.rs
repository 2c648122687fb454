//! Shapes and rays eight at a time: one ray against eight shapes, or eight rays against one shape after the other, which
//! wastes no lane on shapes that do not exist. The same arithmetic as [`crate::scene::shapes`], lane by lane and bit for bit
//! (a test holds it to that), written once over [`Lanes`]: AVX2 where the processor has it, twice four lanes elsewhere.

#[cfg(target_arch = "x86_64")]
use super::vector::{Avx2, has_avx2};
use super::vector::{Fours, LANES, Lane, LaneMask, Lanes};
use crate::scene::compiled::{CompiledScene, Quad, Sphere};
use crate::scene::shapes::{Hit, Ray, T_MISS};
use glam::Vec3;

/// Eight spheres in memory, in registers, or one sphere eight times.
#[derive(Clone, Debug)]
struct SphereBlock<L> {
    center: [L; 3],
    radius: L,
}

/// Eight parallelograms, likewise.
#[derive(Clone, Debug)]
struct QuadBlock<L> {
    corner: [L; 3],
    normal: [L; 3],
    dual1: [L; 3],
    dual2: [L; 3],
}

/// All shapes of a scene in blocks of eight, spheres first. Lanes that no shape fills are never hit.
#[derive(Clone, Debug, Default)]
pub struct ShapeLanes {
    spheres: Vec<SphereBlock<Lane>>,
    quads: Vec<QuadBlock<Lane>>,
    sphere_count: u32,
    quad_count: u32,
}

/// Eight rays. A ray that was never set meets what it likes.
#[derive(Clone, Copy, Debug, Default)]
pub struct RayLanes {
    origin: [Lane; 3],
    direction: [Lane; 3],
}

impl RayLanes {
    /// How many rays go together.
    pub const COUNT: usize = LANES;

    #[inline(always)]
    pub fn set(&mut self, i: usize, ray: Ray) {
        for axis in 0..3 {
            self.origin[axis].0[i] = ray.origin[axis];
            self.direction[axis].0[i] = ray.direction[axis];
        }
    }

    #[inline(always)]
    pub fn get(&self, i: usize) -> Ray {
        let at = |lanes: &[Lane; 3]| Vec3::from_array(std::array::from_fn(|axis| lanes[axis].0[i]));
        Ray { origin: at(&self.origin), direction: at(&self.direction) }
    }
}

/// What bounds eight shadow rays.
#[derive(Clone, Copy, Debug, Default)]
pub struct ShadowEnds {
    t_max: Lane,
    /// In f32, as lanes number shapes.
    excluded_lane: Lane,
    excluded: [u32; LANES],
}

impl ShadowEnds {
    #[inline(always)]
    pub fn set(&mut self, i: usize, t_max: f32, excluded: u32) {
        (self.t_max.0[i], self.excluded_lane.0[i]) = (t_max, excluded as f32);
        self.excluded[i] = excluded;
    }

    /// How far the ray may go, and the shape that does not stop it.
    #[inline(always)]
    pub fn get(&self, i: usize) -> (f32, u32) {
        (self.t_max.0[i], self.excluded[i])
    }
}

/// The values of one lane array, taken from up to eight shapes; `fill` in the rest.
fn gather<T>(shapes: &[T], fill: f32, value: impl Fn(&T) -> f32) -> Lane {
    Lane(std::array::from_fn(|i| shapes.get(i).map_or(fill, &value)))
}

fn gather3<T>(shapes: &[T], value: impl Fn(&T) -> Vec3) -> [Lane; 3] {
    std::array::from_fn(|axis| gather(shapes, 0.0, |shape| value(shape)[axis]))
}

#[inline(always)]
fn splat3<L: Lanes>(v: [f32; 3]) -> [L; 3] {
    [L::splat(v[0]), L::splat(v[1]), L::splat(v[2])]
}

#[inline(always)]
fn load3<L: Lanes>(v: &[Lane; 3]) -> [L; 3] {
    [L::load(&v[0]), L::load(&v[1]), L::load(&v[2])]
}

/// One lane of each, in all lanes.
#[inline(always)]
fn spread3<L: Lanes>(v: &[Lane; 3], i: usize) -> [L; 3] {
    splat3([v[0].0[i], v[1].0[i], v[2].0[i]])
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

/// Eight rays in registers, or one ray eight times.
#[derive(Clone, Copy)]
struct LaneRay<L> {
    origin: [L; 3],
    direction: [L; 3],
}

impl<L: Lanes> LaneRay<L> {
    #[inline(always)]
    fn one(ray: Ray) -> Self {
        LaneRay { origin: splat3(ray.origin.to_array()), direction: splat3(ray.direction.to_array()) }
    }

    #[inline(always)]
    fn eight(rays: &RayLanes) -> Self {
        LaneRay { origin: load3(&rays.origin), direction: load3(&rays.direction) }
    }
}

trait Block {
    type In<L: Lanes>: Distances<L>;
    /// The eight shapes in registers.
    fn load<L: Lanes>(&self) -> Self::In<L>;
    /// One of the eight in all lanes.
    fn spread<L: Lanes>(&self, i: usize) -> Self::In<L>;
}

trait Distances<L> {
    /// Distance along every lane's ray to that lane's shape, [`T_MISS`] if it is not met.
    fn distances(&self, ray: &LaneRay<L>) -> L;
}

impl Block for SphereBlock<Lane> {
    type In<L: Lanes> = SphereBlock<L>;
    #[inline(always)]
    fn load<L: Lanes>(&self) -> SphereBlock<L> {
        SphereBlock { center: load3(&self.center), radius: L::load(&self.radius) }
    }
    #[inline(always)]
    fn spread<L: Lanes>(&self, i: usize) -> SphereBlock<L> {
        SphereBlock { center: spread3(&self.center, i), radius: L::splat(self.radius.0[i]) }
    }
}

impl<L: Lanes> Distances<L> for SphereBlock<L> {
    /// [`crate::scene::shapes::intersect_sphere`] in every lane. A radius that is no number is never hit.
    #[inline(always)]
    fn distances(&self, ray: &LaneRay<L>) -> L {
        let zero = L::splat(0.0);
        let radius2 = self.radius.mul(self.radius);
        let f = sub3(ray.origin, self.center);
        let b = dot(f, ray.direction).neg();
        let approach = along(f, ray.direction, b);
        let discriminant = radius2.sub(dot(approach, approach));
        let root = discriminant.sqrt();
        let near = b.sub(root);
        let t = L::select(zero.lt(near), near, b.add(root));
        let ahead = zero.le(discriminant).and(zero.lt(t));
        // As refine_sphere_distance.
        let sum = L::select(zero.le(b), b, b.neg()).add(root);
        let refined = dot(f, f).sub(radius2).div(L::select(zero.le(b), sum, sum.neg()));
        let cancels = t.lt(sum.mul(L::splat(0.5))).and(zero.lt(refined));
        L::select(ahead, L::select(cancels, refined, t), L::splat(T_MISS))
    }
}

impl Block for QuadBlock<Lane> {
    type In<L: Lanes> = QuadBlock<L>;
    #[inline(always)]
    fn load<L: Lanes>(&self) -> QuadBlock<L> {
        QuadBlock {
            corner: load3(&self.corner),
            normal: load3(&self.normal),
            dual1: load3(&self.dual1),
            dual2: load3(&self.dual2),
        }
    }
    #[inline(always)]
    fn spread<L: Lanes>(&self, i: usize) -> QuadBlock<L> {
        QuadBlock {
            corner: spread3(&self.corner, i),
            normal: spread3(&self.normal, i),
            dual1: spread3(&self.dual1, i),
            dual2: spread3(&self.dual2, i),
        }
    }
}

impl<L: Lanes> Distances<L> for QuadBlock<L> {
    /// [`crate::scene::shapes::intersect_quad`] in every lane. A normal of zero is never hit.
    #[inline(always)]
    fn distances(&self, ray: &LaneRay<L>) -> L {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let from_corner = sub3(ray.origin, self.corner);
        let t = dot(self.normal, from_corner).neg().div(dot(self.normal, ray.direction));
        let p = along(from_corner, ray.direction, t);
        let (a, b) = (dot(p, self.dual1), dot(p, self.dual2));
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
    #[inline(always)]
    fn nothing() -> Self {
        Nearest { t: L::splat(T_MISS), shape: L::splat(f32::INFINITY) }
    }

    #[inline(always)]
    fn or(self, t: L, shape: L) -> Self {
        let nearer = t.lt(self.t);
        Nearest { t: L::select(nearer, t, self.t), shape: L::select(nearer, shape, self.shape) }
    }

    /// One ray, eight shapes at a time; the first is number `first`.
    #[inline(always)]
    fn among(mut self, blocks: &[impl Block], first: u32, ray: &LaneRay<L>) -> Self {
        let mut shape = L::count_from(first as f32);
        for block in blocks {
            self = self.or(block.load().distances(ray), shape);
            shape = shape.add(L::splat(LANES as f32));
        }
        self
    }

    /// Eight rays, one shape at a time.
    #[inline(always)]
    fn for_each(mut self, blocks: &[impl Block], first: u32, count: u32, rays: &LaneRay<L>) -> Self {
        for (number, block) in blocks.iter().enumerate() {
            let before = number * LANES;
            for i in 0..LANES.min(count as usize - before) {
                let shape = first + (before + i) as u32;
                self = self.or(block.spread(i).distances(rays), L::splat(shape as f32));
            }
        }
        self
    }

    /// Of one ray: the first of the nearest shapes, the one that a loop over the shapes would find.
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

    /// Of eight rays.
    #[inline(always)]
    fn hits(self) -> [Option<Hit>; LANES] {
        let (Lane(t), Lane(shape)) = (self.t.store(), self.shape.store());
        std::array::from_fn(|i| (t[i] < T_MISS).then_some(Hit { t: t[i], shape: shape[i] as u32 }))
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
        let t: L = block.load().distances(ray);
        if t.lt(L::splat(t_max)).and(shape.ne(L::splat(excluded as f32))).bits() != 0 {
            return true;
        }
        shape = shape.add(L::splat(LANES as f32));
    }
    false
}

/// The same for eight rays: a bit for each.
#[inline(always)]
fn any_nearer_each<L: Lanes>(
    blocks: &[impl Block],
    first: u32,
    count: u32,
    rays: &LaneRay<L>,
    (t_max, excluded): (L, L),
) -> u32 {
    let mut blocked = 0;
    for (number, block) in blocks.iter().enumerate() {
        let before = number * LANES;
        for i in 0..LANES.min(count as usize - before) {
            let shape = L::splat((first + (before + i) as u32) as f32);
            let t: L = block.spread(i).distances(rays);
            blocked |= t.lt(t_max).and(shape.ne(excluded)).bits();
        }
        if blocked == u32::from(u8::MAX) {
            break;
        }
    }
    blocked
}

/// The method of the name for the best kind of lanes that this processor has.
macro_rules! dispatch {
    ($self:ident.$method:ident($($argument:expr),*) or $avx2:ident) => {{
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the processor has AVX2.
            return unsafe { $self.$avx2($($argument),*) };
        }
        $self.$method::<Fours>($($argument),*)
    }};
}

impl ShapeLanes {
    pub fn new(scene: &CompiledScene) -> ShapeLanes {
        debug_assert!(scene.spheres.len() + scene.quads.len() < 1 << 24, "shapes are numbered in f32");
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
            sphere_count: scene.spheres.len() as u32,
            quad_count: scene.quads.len() as u32,
        }
    }

    /// The nearest shape that the ray meets.
    pub fn intersect(&self, ray: Ray) -> Option<Hit> {
        dispatch!(self.nearest(ray) or nearest_avx2)
    }

    /// Whether anything but `excluded` (the light aimed at) lies nearer than `t_max`.
    pub fn occluded(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        dispatch!(self.any_nearer(ray, t_max, excluded) or any_nearer_avx2)
    }

    /// [`ShapeLanes::intersect`] for eight rays.
    pub fn intersect_eight(&self, rays: &RayLanes) -> [Option<Hit>; LANES] {
        dispatch!(self.nearest_eight(rays) or nearest_eight_avx2)
    }

    /// [`ShapeLanes::occluded`] for eight rays: a bit for each.
    pub fn occluded_eight(&self, rays: &RayLanes, ends: &ShadowEnds) -> u32 {
        dispatch!(self.any_nearer_eight(rays, ends) or any_nearer_eight_avx2)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn nearest_avx2(&self, ray: Ray) -> Option<Hit> {
        self.nearest::<Avx2>(ray)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn any_nearer_avx2(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        self.any_nearer::<Avx2>(ray, t_max, excluded)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn nearest_eight_avx2(&self, rays: &RayLanes) -> [Option<Hit>; LANES] {
        self.nearest_eight::<Avx2>(rays)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn any_nearer_eight_avx2(&self, rays: &RayLanes, ends: &ShadowEnds) -> u32 {
        self.any_nearer_eight::<Avx2>(rays, ends)
    }

    #[inline(always)]
    fn nearest<L: Lanes>(&self, ray: Ray) -> Option<Hit> {
        let ray = LaneRay::<L>::one(ray);
        Nearest::nothing().among(&self.spheres, 0, &ray).among(&self.quads, self.sphere_count, &ray).hit()
    }

    #[inline(always)]
    fn any_nearer<L: Lanes>(&self, ray: Ray, t_max: f32, excluded: u32) -> bool {
        let ray = LaneRay::<L>::one(ray);
        any_nearer(&self.spheres, 0, &ray, t_max, excluded)
            || any_nearer(&self.quads, self.sphere_count, &ray, t_max, excluded)
    }

    #[inline(always)]
    fn nearest_eight<L: Lanes>(&self, rays: &RayLanes) -> [Option<Hit>; LANES] {
        let (rays, spheres) = (LaneRay::<L>::eight(rays), self.sphere_count);
        Nearest::nothing()
            .for_each(&self.spheres, 0, spheres, &rays)
            .for_each(&self.quads, spheres, self.quad_count, &rays)
            .hits()
    }

    #[inline(always)]
    fn any_nearer_eight<L: Lanes>(&self, rays: &RayLanes, ends: &ShadowEnds) -> u32 {
        let (rays, spheres) = (LaneRay::<L>::eight(rays), self.sphere_count);
        let ends = (L::load(&ends.t_max), L::load(&ends.excluded_lane));
        any_nearer_each(&self.spheres, 0, spheres, &rays, ends)
            | any_nearer_each(&self.quads, spheres, self.quad_count, &rays, ends)
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
            for group in 0..2_500 {
                let (mut rays, mut ends) = (RayLanes::default(), ShadowEnds::default());
                let mut expected_hits = [None; LANES];
                let mut expected_shadows = 0;
                for (lane, expected_hit) in expected_hits.iter_mut().enumerate() {
                    let i = (group * LANES + lane) as u32;
                    let u = sample4(Sampler::Independent, SampleKey { pixel: i, sample: 1, seed: 3 }, 0);
                    let v = sample4(Sampler::Independent, SampleKey { pixel: i, sample: 2, seed: 3 }, 0);
                    let origin = eye.lerp(target, u.z);
                    let direction = (Vec3::new(v.x, v.y, v.z) - 0.5).normalize();
                    let ray = Ray { origin, direction };
                    let hit = intersect(&scene, ray);
                    assert_eq!(lanes.intersect(ray), hit, "{name}, ray {i}");
                    assert_eq!(lanes.nearest::<Fours>(ray), hit, "{name}, ray {i}");
                    hits += u32::from(hit.is_some());
                    let (t_max, excluded) = (u.w * size, (v.w * 20.0) as u32);
                    let shaded = occluded(&scene, ray, t_max, excluded);
                    assert_eq!(lanes.occluded(ray, t_max, excluded), shaded, "{name}, ray {i}");
                    assert_eq!(lanes.any_nearer::<Fours>(ray, t_max, excluded), shaded, "{name}, ray {i}");
                    rays.set(lane, ray);
                    ends.set(lane, t_max, excluded);
                    *expected_hit = hit;
                    expected_shadows |= u32::from(shaded) << lane;
                }
                assert_eq!(lanes.intersect_eight(&rays), expected_hits, "{name}, rays {group}");
                assert_eq!(lanes.nearest_eight::<Fours>(&rays), expected_hits, "{name}, rays {group}");
                assert_eq!(lanes.occluded_eight(&rays, &ends), expected_shadows, "{name}, rays {group}");
                let by_fours = lanes.any_nearer_eight::<Fours>(&rays, &ends);
                assert_eq!(by_fours, expected_shadows, "{name}, rays {group}");
            }
            assert!(hits > 2_000, "{name}: only {hits} rays hit anything");
        }
    }
}
