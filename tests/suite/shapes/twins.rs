//! The same questions for the kernels and for their twins on the CPU.

use super::{ask, key};
use crate::probe::{Probe, floats, row};
use crate::support::{open_gpu, quad_index};
use qtracer::accel::ShapeLanes;
use qtracer::gpu::device::Gpu;
use qtracer::scene::bvh::Bvh;
use qtracer::scene::compiled::{CompiledScene, NONE};
use qtracer::scene::rows::{self, Row};
use qtracer::scene::shapes::{
    Hit, Ray, Surface, T_MISS, intersect_quad, intersect_sphere, spawn_ray, surface_at,
};
use rayon::prelude::*;

/// Who answers.
pub enum Twin {
    Kernels(Gpu),
    Cpu,
}

pub fn both_twins() -> [Twin; 2] {
    [Twin::Kernels(open_gpu()), Twin::Cpu]
}

/// A ray and the one shape that it is asked about: `[origin and shape, direction]`.
pub type Aimed = [Row; 2];
/// A surface to leave: `[point and shape, normal and offset, direction]`.
pub type Leaving = [Row; 3];

pub fn aimed(origin: glam::Vec3, direction: glam::Vec3, shape: usize) -> Aimed {
    [row(origin, shape as u32), row(direction, 0)]
}

/// Where a ray meets its shape.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    /// As shading has it, and as the loop over all shapes finds it.
    pub t: f32,
    pub raw: f32,
    pub surface: Surface,
}

/// A ray that has left a surface: its start, how far it goes to the surface's shape, and how far it would the other way.
#[derive(Clone, Copy, Debug)]
pub struct Gone {
    pub origin: glam::Vec3,
    pub ahead: f32,
    pub behind: f32,
}

/// WESL that finds how far along `ray` shape `a.w` lies, as all stages find it: into `raw`, and refined into `t`.
fn distance(scene: &CompiledScene, ray: &str, raw: &str, t: &str) -> String {
    if !scene.spheres.is_empty() {
        return format!(
            "let {raw} = intersect_sphere({ray}, sphere_at(a.w).center, sphere_at(a.w).radius * sphere_at(a.w).radius);
            var {t} = {raw};
            if {raw} < T_MISS {{
                {t} = refine_sphere_distance({ray}, sphere_at(a.w).center, sphere_at(a.w).radius, {raw});
            }}"
        );
    }
    format!(
        "let quad_{t} = quad_at(a.w);
        let {raw} = intersect_quad({ray}, quad_{t}.corner, quad_{t}.normal, quad_{t}.dual1, quad_{t}.dual2);
        let {t} = {raw};"
    )
}

const IMPORTS: &str = "import package::scene::shapes::{Hit, Ray, Surface, T_MISS, spawn_ray, surface_at};
    @if(spheres) import package::scene::data::sphere_at;
    @if(spheres) import package::scene::shapes::{intersect_sphere, refine_sphere_distance};
    @if(quads) import package::scene::data::quad_at;
    @if(quads) import package::scene::shapes::intersect_quad;";

/// The scene as the hierarchy asks it, however small.
pub fn with_hierarchy(scene: &CompiledScene) -> CompiledScene {
    CompiledScene { bvh: Some(Bvh::new(scene)), aligned: [0; 3], ..scene.clone() }
}

/// How far along the ray this shape lies, on the CPU.
pub fn cpu_distance(scene: &CompiledScene, ray: &Ray, shape: u32) -> f32 {
    match quad_index(scene, shape) {
        None => intersect_sphere(ray, &scene.spheres[shape as usize]),
        Some(i) => intersect_quad(ray, &scene.quads[i]),
    }
}

/// Of a large scene they are not bound.
fn hot(scene: &CompiledScene) -> Vec<Row> {
    if scene.is_small() { rows::hot(scene) } else { Vec::new() }
}

impl Twin {
    pub fn name(&self) -> &'static str {
        match self {
            Twin::Kernels(_) => "kernels",
            Twin::Cpu => "CPU",
        }
    }

    /// Where each ray meets its shape. Of a miss the surface means nothing.
    pub fn meet(&self, scene: &CompiledScene, rays: &[Aimed]) -> Vec<Met> {
        let Twin::Kernels(gpu) = self else {
            return rays.par_iter().map(|ray| cpu_meet(scene, ray)).collect();
        };
        let body = format!(
            "let ray = Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz));
            {}
            let surface = surface_at(ray, Hit(t, a.w));
            out0 = vec4<u32>(bitcast<vec3<u32>>(surface.position), bitcast<u32>(t));
            out1 = vec4<u32>(bitcast<vec3<u32>>(surface.normal), bitcast<u32>(surface.offset));
            out2.x = bitcast<u32>(raw);",
            distance(scene, "ray", "raw", "t")
        );
        let probe = Probe::<2, 3>::new(gpu, &key(scene), IMPORTS, &body);
        let met = |[point, normal, raw]: [Row; 3]| {
            let ((position, t), (normal, offset)) = (floats(point), floats(normal));
            Met { t, raw: f32::from_bits(raw[0]), surface: Surface::plain(position, normal, offset) }
        };
        ask(gpu, &probe, scene, &hot(scene), rays).into_iter().map(met).collect()
    }

    /// The nearest shape that each ray meets, NONE if none; in the kernels by the hierarchy if the scene has one.
    pub fn nearest(&self, scene: &CompiledScene, rays: &[Aimed]) -> Vec<u32> {
        let Twin::Kernels(gpu) = self else {
            let lanes = ShapeLanes::new(scene);
            let nearest = |&[a, b]: &Aimed| {
                let ray = Ray { origin: floats(a).0, direction: floats(b).0 };
                lanes.intersect(ray).map_or(NONE, |hit| hit.shape)
            };
            return rays.par_iter().map(nearest).collect();
        };
        let imports = "@if(bvh) import package::scene::bvh::intersect;
            @if(!bvh) import package::scene::shapes::intersect;
            import package::scene::shapes::Ray;";
        let body = "out0.x = intersect(Ray(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz))).shape;";
        let mut key = key(scene);
        key.small_scene = key.small_scene.filter(|_| scene.bvh.is_none());
        let probe = Probe::<2, 1>::new(gpu, &key, imports, body);
        ask(gpu, &probe, scene, &hot(scene), rays).into_iter().map(|[answer]| answer[0]).collect()
    }

    /// Where rays go that leave surfaces.
    pub fn leave(&self, scene: &CompiledScene, leaving: &[Leaving]) -> Vec<Gone> {
        let Twin::Kernels(gpu) = self else {
            return leaving.par_iter().map(|leaving| cpu_leave(scene, leaving)).collect();
        };
        let body = format!(
            "let surface = Surface(bitcast<vec3<f32>>(a.xyz), bitcast<vec3<f32>>(b.xyz), bitcast<f32>(b.w));
            let ray = spawn_ray(surface, bitcast<vec3<f32>>(c.xyz));
            let reverse = Ray(ray.origin, -ray.direction);
            {} {}
            out0 = vec4<u32>(bitcast<vec3<u32>>(ray.origin), bitcast<u32>(ahead));
            out1.x = bitcast<u32>(behind);",
            distance(scene, "ray", "raw_ahead", "ahead"),
            distance(scene, "reverse", "raw_behind", "behind")
        );
        let probe = Probe::<3, 2>::new(gpu, &key(scene), IMPORTS, &body);
        let gone = |[start, behind]: [Row; 2]| {
            let (origin, ahead) = floats(start);
            Gone { origin, ahead, behind: f32::from_bits(behind[0]) }
        };
        ask(gpu, &probe, scene, &hot(scene), leaving).into_iter().map(gone).collect()
    }
}

fn cpu_meet(scene: &CompiledScene, &[a, b]: &Aimed) -> Met {
    let ray = Ray { origin: floats(a).0, direction: floats(b).0 };
    let t = cpu_distance(scene, &ray, a[3]);
    Met { t, raw: t, surface: surface_at(scene, ray, Hit { t, shape: a[3] }) }
}

fn cpu_leave(scene: &CompiledScene, &[a, b, c]: &Leaving) -> Gone {
    let (normal, offset) = floats(b);
    let ray = spawn_ray(&Surface::plain(floats(a).0, normal, offset), floats(c).0);
    let reverse = Ray { direction: -ray.direction, ..ray };
    let [ahead, behind] = [ray, reverse].map(|ray| cpu_distance(scene, &ray, a[3]));
    Gone { origin: ray.origin, ahead, behind }
}

impl Met {
    pub fn hit(&self) -> bool {
        self.raw < T_MISS
    }

    /// Leaves the surface of `shape` towards `direction`, from `scale` times its offset.
    pub fn leaving(&self, shape: u32, direction: glam::Vec3, scale: f32) -> Leaving {
        let Surface { position, normal, offset, .. } = self.surface;
        [row(position, shape), row(normal, (offset * scale).to_bits()), row(direction, 0)]
    }
}
