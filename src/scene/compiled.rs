//! The scene as the transport sees it: f32, flat arrays, lights with their table. GPU twin: kernels/scene/data.wesl

use super::bvh::Bvh;
use super::environment::{Sky, environment_share};
use super::instance::instanced_triangle;
use super::light_tree::{FEWEST_LIGHTS, LightTree, MOST_LIGHTS};
use super::shapes::RELATIVE_OFFSET;
use super::sharing::{Instancing, Shared};
use super::surfaces::Surfaces;
use super::triangle::double_area;
use super::{Camera, Geometry, MaterialKind, Mesh, Scene, rows};
use crate::gpu_struct;
use crate::math::fnv1a;
use crate::sampling::AliasTable;
use glam::{DVec3, Vec3};

/// Material kinds: what routes a hit to its queue.
pub const KIND_DIFFUSE: u32 = 0;
pub const KIND_MIRROR: u32 = 1;
pub const KIND_GLOSSY: u32 = 2;
pub const KIND_DIELECTRIC: u32 = 3;
pub const KIND_METAL: u32 = 4;
pub const KIND_METALLIC_ROUGHNESS: u32 = 5;
pub const KIND_ROUGH_DIELECTRIC: u32 = 6;
/// How many kinds there are.
pub const KINDS: usize = 7;
/// The least α of GGX; smoother surfaces are taken for this smooth, a roughness of 0.032. The lobe of a smaller one is narrower
/// than f32 directions can tell to a thousandth.
pub const LEAST_ALPHA: f32 = 1e-3;
/// "No light", where an index is expected.
pub const NONE: u32 = u32::MAX;

gpu_struct! {
    /// Numbers of a frame and of the batch in flight; one uniform buffer.
    pub struct Uniforms {
        camera_origin: Vec3,
        seed: u32,
        /// Half the width of the image plane at distance 1, pointing right.
        camera_right: Vec3,
        width: u32,
        /// Half its height, pointing up.
        camera_up: Vec3,
        height: u32,
        camera_forward: Vec3,
        /// Levels a path may have, 1 to 64.
        max_bounces: u32,
        /// Radiance of whatever lies beyond the scene.
        environment: Vec3,
        /// The batch covers pixels first_pixel .. first_pixel + pixel_count, row by row from the top.
        first_pixel: u32,
        pixel_count: u32,
        /// … and samples first_sample .. first_sample + sample_count of each.
        first_sample: u32,
        sample_count: u32,
        /// Paths to trace: of the batch, or of one dispatch of the megakernel that starts at first_path.
        path_count: u32,
        first_path: u32,
        /// Items that each queue holds.
        capacity: u32,
        sphere_count: u32,
        quad_count: u32,
        triangle_count: u32,
        light_count: u32,
        /// How much an invocation does before it passes on: levels of its path in `step` (more where few rays are left) and, at
        /// most, in `follow_*`; paths in `megakernel`.
        grain: u32,
        /// The megakernel's last workgroups, from this one on, trace fewer paths: `late_grain` for each invocation.
        early_groups: u32,
        late_grain: u32,
        /// Where few rays are left, visits of `step` get longer, up to so many levels, …
        longest_visit: u32,
        /// … so that a level of them all traces about so many rays.
        least_rays: u32,
        /// Where the parts of the scene that only hits read begin, in rows: scene/rows.rs.
        first_sphere_rest_row: u32,
        first_quad_rest_row: u32,
        first_triangle_row: u32,
        first_material_row: u32,
        first_light_row: u32,
        first_node_row: u32,
        first_triangle_normals_row: u32,
        first_triangle_uvs_row: u32,
        first_material_maps_row: u32,
        first_texture_image_row: u32,
        first_texel_row: u32,
        first_srgb_row: u32,
        /// Survival in roulette is this times what it would be.
        roulette_scale: f32,
        /// The environment map: where it begins, its size, and by how much of a turn its longitude is ahead of the world's.
        first_sky_row: u32,
        first_sky_cell_row: u32,
        sky_width: u32,
        sky_height: u32,
        sky_turn: f32,
        /// Chance that direct light asks the environment map, not a lamp.
        environment_share: f32,
        first_cluster_row: u32,
        /// The rest of the materials, of what has microfacets.
        first_material_rest_row: u32,
    }
    /// What every ray reads comes first; rows.rs says where that ends.
    pub struct Sphere {
        center: Vec3,
        radius: f32,
        material: u32,
        kind: u32,
        /// Index into the lights, NONE if it does not shine.
        light: u32,
        /// 1 if the outer side is inside.
        inward: u32,
    }
    /// The parallelogram corner + a·e1 + b·e2, a and b in 0..1. What every ray reads comes first, as in a sphere.
    pub struct Quad {
        corner: Vec3,
        material: u32,
        /// e1 × e2, normalised.
        normal: Vec3,
        area: f32,
        /// dual1·(p − corner) = a for p in the plane.
        dual1: Vec3,
        kind: u32,
        /// dual2·(p − corner) = b.
        dual2: Vec3,
        light: u32,
        e1: Vec3,
        _pad0: u32,
        e2: Vec3,
        _pad1: u32,
    }
    /// A triangle of a mesh; its outer side is the one from which a, b, c go counterclockwise.
    pub struct Triangle {
        a: Vec3,
        material: u32,
        b: Vec3,
        kind: u32,
        c: Vec3,
        light: u32,
    }
    pub struct Material {
        color: Vec3,
        kind: u32,
        /// Radiance leaving the outer side.
        emission: Vec3,
        /// Mirror: level. Glossy: exponent. Dielectrics: index of refraction.
        parameter: f32,
        /// Of what has microfacets, 0 to 1; scenes without have this row nowhere.
        roughness: f32,
        /// Metallic-roughness: 0, a coat over a diffuse base, to 1, metal.
        metallic: f32,
        _pad0: u32,
        _pad1: u32,
    }
    /// An emitting shape, and its row of the alias table by power.
    pub struct Light {
        shape: u32,
        material: u32,
        /// Probability with which this light is chosen.
        pick_probability: f32,
        /// Stay on this row below, go to alias_index from here on.
        threshold: f32,
        alias_index: u32,
        /// Which cluster of the light tree it is, where there is one.
        cluster: u32,
        _pad0: u32,
        _pad1: u32,
    }
}

/// A [`Scene`] in the form in which rays meet it.
#[derive(Clone, Debug, Default)]
pub struct CompiledScene {
    pub spheres: Vec<Sphere>,
    /// Rectangles whose sides run along axes come first: those at right angles to x, to y, to z.
    pub quads: Vec<Quad>,
    /// How many of each of those there are.
    pub aligned: [usize; 3],
    /// Of meshes, each at one place. A scene that has any has a hierarchy.
    pub triangles: Vec<Triangle>,
    /// Meshes that are stored once, and their instances, which have a second level of the hierarchy.
    pub shared: Shared,
    pub materials: Vec<Material>,
    pub lights: Vec<Light>,
    /// Where the lights are too many to choose by power alone.
    pub light_tree: Option<LightTree>,
    /// Radiance from beyond the scene where there is no map of it.
    pub environment: Vec3,
    /// Normals, texture coordinates and textures.
    pub surfaces: Surfaces,
    pub sky: Option<Sky>,
    /// Where the shapes are too many to ask them all.
    pub bvh: Option<Bvh>,
}

/// A shape by its number among all: spheres come first, then quads, then triangles. Those of instances go on behind the
/// others: [`CompiledScene::triangle`] knows all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShapeIndex {
    Sphere(usize),
    Quad(usize),
    Triangle(usize),
}

/// Bytes of what every ray reads of the shapes up to which it may as well ask them all: they lie in a cache of about 2 KiB, and
/// loops over them unroll. Measured on an H100 with the fused schedule: 2,080 B (door) take 0.62 of the time that the
/// hierarchy takes, 4.6 KB (many-lights) 1.46 times as long.
const SMALL_SHAPES: usize = 2560;

impl CompiledScene {
    pub fn new(scene: &Scene) -> CompiledScene {
        Self::with_instances(scene, Instancing::Auto)
    }

    /// The same, with a say in which meshes are shared.
    pub fn with_instances(scene: &Scene, instancing: Instancing) -> CompiledScene {
        let mut compiled = CompiledScene {
            materials: scene.materials.iter().map(compile_material).collect(),
            surfaces: Surfaces::new(scene),
            environment: scene.environment_map.as_ref().map_or(scene.environment.as_vec3(), |_| Vec3::ZERO),
            sky: scene.environment_map.as_ref().and_then(|map| Sky::new(map, scene.environment)),
            ..Default::default()
        };
        // Emitters first: where a lamp lies flush in another surface, rays that meet both at once see the lamp.
        let mut shapes: Vec<_> = scene.shapes.iter().collect();
        shapes.sort_by_key(|shape| !scene.materials[shape.material].is_emissive());
        for shape in &shapes {
            let (material, kind) = (shape.material as u32, compiled.materials[shape.material].kind);
            match &shape.geometry {
                &Geometry::Sphere { center, radius, inward } => compiled.spheres.push(Sphere {
                    center: center.as_vec3(),
                    radius: radius as f32,
                    material,
                    kind,
                    light: NONE,
                    inward: inward as u32,
                }),
                &Geometry::Quad { corner, e1, e2 } => {
                    let shines = scene.materials[shape.material].is_emissive();
                    let [corner, e1, e2] = if shines { [corner, e1, e2] } else { widened([corner, e1, e2]) };
                    let quad = compile_quad(corner, e1, e2);
                    compiled.quads.push(Quad { material, kind, light: NONE, ..quad });
                }
                Geometry::Mesh(mesh) => {
                    compiled.triangles.extend(compile_mesh(mesh, material, kind));
                    compiled.surfaces.add_mesh(mesh);
                }
                Geometry::Instance(_) => {}
            }
        }
        let meshes = compiled.add_instances(&shapes, instancing);
        compiled.sort_quads();
        let lamps_power = compiled.find_lights();
        let share = environment_share(&compiled, lamps_power);
        compiled.sky.iter_mut().for_each(|sky| sky.share = share);
        compiled.light_tree = (FEWEST_LIGHTS..=MOST_LIGHTS)
            .contains(&compiled.lights.len())
            .then(|| LightTree::new(&mut compiled));
        compiled.bvh = (!compiled.is_small()).then(|| Bvh::new(&compiled));
        if let Some(bvh) = &mut compiled.bvh {
            let first_nodes = bvh.join(&meshes);
            for instance in &mut compiled.shared.instances {
                instance.first_node = first_nodes[instance.first_node as usize];
            }
        }
        compiled
    }

    /// Puts quads that are easily tested first, each kind in the order that it had.
    fn sort_quads(&mut self) {
        let kind = |quad: &Quad| quad.axis().unwrap_or(3);
        self.quads.sort_by_key(kind);
        self.aligned = [0, 1, 2].map(|axis| self.quads.iter().filter(|quad| kind(quad) == axis).count());
    }

    /// Whether rays ask all shapes.
    pub fn is_small(&self) -> bool {
        let meshes = !self.triangles.is_empty() || !self.shared.instances.is_empty();
        !meshes && size_of_val(&rows::hot(self)[..]) <= SMALL_SHAPES
    }

    /// Which shape has that number.
    #[inline(always)]
    pub fn shape_index(&self, shape: u32) -> ShapeIndex {
        let shape = shape as usize;
        let Some(behind_spheres) = shape.checked_sub(self.spheres.len()) else {
            return ShapeIndex::Sphere(shape);
        };
        match behind_spheres.checked_sub(self.quads.len()) {
            None => ShapeIndex::Quad(behind_spheres),
            Some(triangle) => ShapeIndex::Triangle(triangle),
        }
    }

    /// A triangle in the world, of an instance too.
    #[inline(always)]
    pub fn triangle(&self, i: usize) -> Triangle {
        match self.triangles.get(i) {
            Some(triangle) => *triangle,
            None => instanced_triangle(self, self.triangle_shape(i)),
        }
    }

    /// The number of a triangle among all shapes.
    #[inline(always)]
    pub fn triangle_shape(&self, i: usize) -> u32 {
        (self.spheres.len() + self.quads.len() + i) as u32
    }

    /// A triangle of a mesh that is shared, in its coordinates, by its number among all that are stored.
    #[inline(always)]
    pub fn shared_triangle(&self, stored: usize) -> &Triangle {
        &self.shared.triangles[stored - self.triangles.len()]
    }

    /// How many triangles are seen, of each instance too.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len() + self.shared.seen
    }

    /// How many shapes there are, with the triangles of each instance.
    pub fn shape_count(&self) -> usize {
        self.spheres.len() + self.quads.len() + self.triangle_count()
    }

    /// How many shapes a ray asks, or how many it could ask in the time of its walk: on an H100 asking 64 quads takes 0.62 of
    /// the hierarchy's time, and asking the 228 shapes of many-lights 1.46 times as long.
    pub fn tests_per_ray(&self) -> usize {
        match self.bvh {
            None => self.shape_count(),
            Some(_) => 16 * self.shape_count().ilog2() as usize,
        }
    }

    /// Whether there is anything for direct light to aim at.
    pub fn has_light_to_sample(&self) -> bool {
        !self.lights.is_empty() || self.sky.is_some()
    }

    /// Radiance that the material emits on average over its texture, of all channels together.
    pub fn mean_emission(&self, material: u32) -> f64 {
        let emission = self.materials[material as usize].emission * self.surfaces.mean_emission(material);
        emission.as_dvec3().element_sum()
    }

    /// Every emitting shape, chosen with probability proportional to its power; returns the power of all, over π.
    fn find_lights(&mut self) -> f64 {
        let emissions: Vec<f64> = (0..self.materials.len() as u32).map(|m| self.mean_emission(m)).collect();
        let CompiledScene { spheres, quads, triangles, lights, .. } = self;
        let mut powers = Vec::new();
        let mut register = |shape: usize, material: u32, area: f64| -> u32 {
            let power = emissions[material as usize] * area;
            if power <= 0.0 {
                return NONE;
            }
            powers.push(power);
            lights.push(Light { shape: shape as u32, material, ..Default::default() });
            lights.len() as u32 - 1
        };
        for (i, sphere) in spheres.iter_mut().enumerate() {
            let area = 4.0 * std::f64::consts::PI * f64::from(sphere.radius).powi(2);
            sphere.light = register(i, sphere.material, area);
        }
        for (i, quad) in quads.iter_mut().enumerate() {
            quad.light = register(spheres.len() + i, quad.material, quad.area.into());
        }
        for (i, triangle) in triangles.iter_mut().enumerate() {
            let Triangle { a, b, c, .. } = *triangle;
            let area = 0.5 * double_area(a, b, c).as_dvec3().length();
            triangle.light = register(spheres.len() + quads.len() + i, triangle.material, area);
        }
        for (light, row) in lights.iter_mut().zip(AliasTable::new(&powers).rows) {
            light.pick_probability = row.probability;
            light.threshold = row.threshold;
            light.alias_index = row.alias;
        }
        powers.iter().sum()
    }

    /// A number that differs between different pictures (FNV-1a over geometry, materials and camera), so that shards of
    /// different scenes are not merged. Not cryptographic.
    pub fn fingerprint(&self, uniforms: &Uniforms) -> u64 {
        // Neither changes what the picture converges to.
        let picture = Uniforms { seed: 0, roulette_scale: 1.0, ..*uniforms };
        fnv1a(self.arrays().chain([bytemuck::bytes_of(&picture)]))
    }

    /// A number that differs between scenes that light spreads in differently, wherever the camera is (FNV-1a).
    pub fn light_fingerprint(&self) -> u64 {
        let turn = self.sky.as_ref().map_or(0.0, |sky| sky.turn);
        let far = [bytemuck::bytes_of(&self.environment), bytemuck::bytes_of(&turn)];
        fnv1a(self.arrays().chain(far))
    }

    fn arrays(&self) -> impl Iterator<Item = &[u8]> {
        let CompiledScene { spheres, quads, triangles, materials, .. } = self;
        let sky = self.sky.as_ref().map_or(&[][..], |sky| &sky.cells);
        use bytemuck::cast_slice as bytes;
        let (shared, instances) = (bytes(&self.shared.triangles), bytes(&self.shared.instances));
        let shapes =
            [bytes(spheres), bytes(quads), bytes(triangles), bytes(materials), bytes(sky), shared, instances];
        shapes.into_iter().chain(self.surfaces.bytes())
    }

    /// Which material kinds the shapes use.
    pub fn kinds(&self) -> [bool; KINDS] {
        let used = self.spheres.iter().map(|s| s.kind).chain(self.quads.iter().map(|q| q.kind));
        let used = used.chain(self.triangles.iter().map(|t| t.kind));
        let used = used.chain(self.shared.instances.iter().map(|i| i.kind));
        let mut kinds = [false; KINDS];
        used.for_each(|kind| kinds[kind as usize] = true);
        kinds
    }

    /// Whether there is a material of microfacets.
    pub fn has_microfacets(&self) -> bool {
        self.materials.iter().any(|material| material.kind >= KIND_METAL)
    }

    /// The uniforms of a frame seen through `camera` at the given size; the batch is left empty.
    pub fn uniforms(&self, camera: &Camera, width: u32, height: u32, seed: u32) -> Uniforms {
        let forward = (camera.target - camera.origin).normalize();
        let right = forward.cross(camera.up).normalize();
        let half_height = (camera.fov_y_deg.to_radians() * 0.5).tan();
        let half_width = half_height * f64::from(width) / f64::from(height);
        let (sky_width, sky_height, sky_turn, environment_share) =
            self.sky.as_ref().map_or((0, 0, 0.0, 0.0), |sky| (sky.width, sky.height, sky.turn, sky.share));
        let mut uniforms = Uniforms {
            camera_origin: camera.origin.as_vec3(),
            seed,
            camera_right: (right * half_width).as_vec3(),
            width,
            camera_up: (right.cross(forward) * half_height).as_vec3(),
            height,
            camera_forward: forward.as_vec3(),
            environment: self.environment,
            sphere_count: self.spheres.len() as u32,
            quad_count: self.quads.len() as u32,
            triangle_count: self.triangles.len() as u32,
            light_count: self.lights.len() as u32,
            grain: 1,
            sky_width,
            sky_height,
            sky_turn,
            environment_share,
            ..Default::default()
        };
        rows::tell_first_rows(self, &mut uniforms);
        uniforms
    }
}

impl Quad {
    /// The axis that a rectangle with sides along the other two is at right angles to.
    pub fn axis(&self) -> Option<usize> {
        let along = |v: Vec3| {
            let nonzero: Vec<usize> = (0..3).filter(|&k| v[k] != 0.0).collect();
            if let [axis] = nonzero[..] { Some(axis) } else { None }
        };
        let axes = [along(self.normal)?, along(self.dual1)?, along(self.dual2)?];
        (axes.iter().sum::<usize>() == 3 && axes[1] != axes[2]).then_some(axes[0])
    }
}

fn compile_material(material: &super::Material) -> Material {
    let (kind, color, parameter) = match material.kind {
        MaterialKind::Diffuse { color } => (KIND_DIFFUSE, color, 0.0),
        MaterialKind::Mirror { color, level } => (KIND_MIRROR, color, level),
        MaterialKind::Glossy { color, exponent } => (KIND_GLOSSY, color, exponent),
        MaterialKind::Dielectric { tint, ior } => (KIND_DIELECTRIC, tint, ior),
        MaterialKind::Metal { color, .. } => (KIND_METAL, color, 0.0),
        MaterialKind::MetallicRoughness { color, .. } => (KIND_METALLIC_ROUGHNESS, color, 0.0),
        MaterialKind::RoughDielectric { tint, ior, .. } => (KIND_ROUGH_DIELECTRIC, tint, ior),
    };
    let metallic = match material.kind {
        MaterialKind::MetallicRoughness { metallic, .. } => metallic,
        _ => 0.0,
    };
    Material {
        color: color.as_vec3(),
        kind,
        emission: material.emission.as_vec3(),
        parameter: parameter as f32,
        roughness: material.kind.roughness().unwrap_or(0.0) as f32,
        metallic: metallic as f32,
        ..Default::default()
    }
}

/// How far quads reach beyond their edges, relative to their largest coordinate: a quarter of the offset at which rays start.
/// Without that, rays slip between two that share an edge where they pass it within 2⁻²⁴ of coordinates and length.
const EDGE_MARGIN: f64 = RELATIVE_OFFSET as f64 / 4.0;
/// … but not farther than this share of their size.
const WIDEST_MARGIN: f64 = 1e-3;

/// Corner and sides of a quad with its edges moved outwards, rounded to f32 so that all that is made of them agrees. Not for
/// lamps, whose area is their power.
fn widened([corner, e1, e2]: [DVec3; 3]) -> [DVec3; 3] {
    let corners = [corner, corner + e1, corner + e2, corner + e1 + e2];
    let largest = corners.iter().fold(0.0f64, |most, v| most.max(v.abs().max_element()));
    let area = e1.cross(e2).length();
    // Of each side, the share by which the edges at its ends move: their distance is the area over the other side.
    let [a, b] = [e2, e1].map(|other| (EDGE_MARGIN * largest * other.length() / area).min(WIDEST_MARGIN));
    [corner - e1 * a - e2 * b, e1 * (1.0 + 2.0 * a), e2 * (1.0 + 2.0 * b)].map(|v| v.as_vec3().as_dvec3())
}

fn compile_quad(corner: DVec3, e1: DVec3, e2: DVec3) -> Quad {
    let cross = e1.cross(e2);
    let normal = cross.normalize();
    let (towards1, towards2) = (e2.cross(normal), normal.cross(e1));
    Quad {
        corner: corner.as_vec3(),
        e1: e1.as_vec3(),
        e2: e2.as_vec3(),
        normal: normal.as_vec3(),
        area: cross.length() as f32,
        dual1: (towards1 / e1.dot(towards1)).as_vec3(),
        dual2: (towards2 / e2.dot(towards2)).as_vec3(),
        ..Default::default()
    }
}

fn compile_mesh(mesh: &Mesh, material: u32, kind: u32) -> impl Iterator<Item = Triangle> + '_ {
    mesh.triangles().map(move |[a, b, c]| Triangle { a, material, b, kind, c, light: NONE })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quads_reach_a_quarter_of_an_offset_beyond_their_edges_and_lamps_do_not() {
        let described = [DVec3::new(3.0, -2.0, 5.0), DVec3::new(4.0, 0.0, 0.0), DVec3::new(2.0, 0.0, 2.0)];
        let [corner, e1, e2] = widened(described);
        // The farthest corner is at x = 9: the edges move 9 · 2⁻²² = 2.1e-6, which f32 rounds by a tenth and more.
        let margin = 9.0 * EDGE_MARGIN;
        let moved = described[0].z - corner.z;
        assert!((moved / margin - 1.0).abs() < 0.3, "{moved:e} for {margin:e}");
        let far = (corner + e2).z - (described[0] + described[2]).z;
        assert!((far / margin - 1.0).abs() < 0.3, "{far:e} for {margin:e}");
        assert!(e1.z == 0.0 && e1.y == 0.0 && e1.x > 4.0, "{e1} leaves its axis");
        // Far away a small quad grows by a five hundredth at most.
        let [_, e1, _] = widened([DVec3::splat(1e6), DVec3::X, DVec3::Y]);
        assert!((e1.x - 1.002).abs() < 1e-6, "{e1}");
        let lamp = crate::Scene::load("scenes/cornell-box.toml").unwrap();
        let quads = CompiledScene::new(&lamp).quads;
        let sizes: Vec<f32> =
            quads.iter().filter(|q| q.light != NONE).flat_map(|q| [q.e1.x, q.e2.z]).collect();
        assert_eq!(sizes, [130.0, 105.0]);
    }
}
