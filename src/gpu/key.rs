//! What a scene needs of the kernels. Model only what a scene needs: which functions, bindings, queues and fields exist
//! is decided by this key alone, which depends on the scene and the options and on nothing else.

use crate::guiding::GuideMode;
use crate::random::Sampler;
use crate::scene::compiled::{
    CompiledScene, KIND_DIELECTRIC, KIND_DIFFUSE, KIND_GLOSSY, KIND_METAL, KIND_METALLIC_ROUGHNESS,
    KIND_MIRROR, KIND_ROUGH_DIELECTRIC, KINDS, ShapeIndex,
};
use crate::transport::estimators::Estimators;
use crate::transport::roulette::Roulette;
use std::fmt;

/// Names of the material kinds, by number.
pub const KIND_NAMES: [&str; KINDS] =
    ["diffuse", "mirror", "glossy", "dielectric", "metal", "metallic_roughness", "rough_dielectric"];

/// What the linked kernels must be able to do. Equal keys link equal kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct KernelKey {
    pub spheres: bool,
    pub quads: bool,
    /// Of meshes.
    pub triangles: bool,
    /// Whether any mesh has normals at its corners.
    pub smooth: bool,
    /// Whether anything is textured,
    pub textures: bool,
    /// … has normals from a texture,
    pub normal_maps: bool,
    /// … or shines by one.
    pub textured_lamps: bool,
    /// Material kinds present.
    pub kinds: [bool; KINDS],
    /// Light that comes from beyond the scene.
    pub environment: bool,
    /// … that differs by direction.
    pub environment_map: bool,
    /// Next-event estimation: off without lights and environment map, and where no material could use it.
    pub direct_light: bool,
    pub sphere_lights: bool,
    pub quad_lights: bool,
    pub triangle_lights: bool,
    /// Lights chosen by a tree over them, for scenes that have many.
    pub light_tree: bool,
    pub roulette: Roulette,
    /// Places that a path has for its radiance; more than one where paths split.
    pub places: u32,
    /// The kind of table that is learnt, None if nothing is.
    pub guide: Option<GuideMode>,
    /// Whether it guides directions, not roulette alone.
    pub guided: bool,
    /// Whether paths teach; afterwards the table is only asked.
    pub teaches: bool,
    pub stratified: bool,
    /// Depth of the hierarchy over the shapes, if they are too many to ask them all.
    pub bvh: Option<u32>,
    /// How many instances of shared meshes there are, if any; then the hierarchy has two levels.
    pub instances: Option<u32>,
    /// Numbers of shapes, if they are few enough for a uniform buffer and unrolled loops.
    pub small_scene: Option<SmallScene>,
}

/// How many shapes of each kind there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SmallScene {
    pub spheres: u32,
    /// Of these …
    pub quads: u32,
    /// … so many are at right angles to each axis; they come first.
    pub aligned: [u32; 3],
}

fn small_scene(scene: &CompiledScene) -> Option<SmallScene> {
    scene.is_small().then(|| SmallScene {
        spheres: scene.spheres.len() as u32,
        quads: scene.quads.len() as u32,
        aligned: scene.aligned.map(|n| n as u32),
    })
}

impl KernelKey {
    pub fn new(scene: &CompiledScene, estimators: &Estimators) -> Self {
        let kinds = scene.kinds();
        let direct_light = estimators.direct_light && scene.has_light_to_sample() && non_delta(&kinds);
        let light = |is: fn(ShapeIndex) -> bool| {
            direct_light && scene.lights.iter().any(|light| is(scene.shape_index(light.shape)))
        };
        KernelKey {
            spheres: !scene.spheres.is_empty(),
            quads: !scene.quads.is_empty(),
            triangles: scene.triangle_count() > 0,
            smooth: !scene.surfaces.normals.is_empty(),
            textures: scene.surfaces.is_textured(),
            normal_maps: scene.surfaces.normal_maps,
            textured_lamps: direct_light && scene.surfaces.textured_lamps,
            kinds,
            environment: scene.environment.max_element() > 0.0 || scene.sky.is_some(),
            environment_map: scene.sky.is_some(),
            direct_light,
            sphere_lights: light(|shape| matches!(shape, ShapeIndex::Sphere(_))),
            quad_lights: light(|shape| matches!(shape, ShapeIndex::Quad(_))),
            triangle_lights: light(|shape| matches!(shape, ShapeIndex::Triangle(_))),
            light_tree: direct_light && scene.light_tree.is_some(),
            roulette: estimators.roulette,
            places: estimators.places(),
            guide: estimators.learns().then(|| estimators.table_mode()),
            guided: estimators.guide != GuideMode::Off,
            teaches: estimators.learns(),
            stratified: estimators.sampler == Sampler::Stratified,
            bvh: scene.bvh.as_ref().map(|bvh| bvh.depth),
            instances: Some(scene.shared.instances.len() as u32).filter(|&count| count > 0),
            small_scene: small_scene(scene),
        }
    }

    /// The same key for paths that only ask the table.
    pub fn frozen(self) -> Self {
        KernelKey { teaches: false, ..self }
    }

    /// The same key for a kernel that meets one material kind only.
    pub fn only_kind(self, kind: u32) -> Self {
        let mut kinds = [false; KINDS];
        kinds[kind as usize] = true;
        KernelKey { kinds, ..self }
    }

    /// The same key for a kernel that does not meet this kind.
    pub fn without_kind(self, kind: Option<u32>) -> Self {
        let mut kinds = self.kinds;
        if let Some(kind) = kind {
            kinds[kind as usize] = false;
        }
        KernelKey { kinds, ..self }
    }

    /// The material kind that has a kernel of its own in the sorted schedule, if the scene has it: most surfaces are diffuse. It
    /// is the first of the queues.
    pub fn own_kernel(&self) -> Option<u32> {
        self.kinds[KIND_DIFFUSE as usize].then_some(KIND_DIFFUSE)
    }

    /// Feature flags of the kernel sources.
    pub fn flags(&self) -> Vec<(&'static str, bool)> {
        vec![
            ("spheres", self.spheres),
            ("quads", self.quads),
            ("triangles", self.triangles),
            ("smooth_normals", self.smooth),
            ("textures", self.textures),
            ("normal_maps", self.normal_maps),
            ("shading_normals", self.smooth || self.normal_maps),
            ("textured_lamps", self.textured_lamps),
            ("diffuse", self.kinds[KIND_DIFFUSE as usize]),
            ("mirror", self.kinds[KIND_MIRROR as usize]),
            ("glossy", self.kinds[KIND_GLOSSY as usize]),
            ("dielectric", self.kinds[KIND_DIELECTRIC as usize]),
            ("metal", self.kinds[KIND_METAL as usize]),
            ("metallic_roughness", self.kinds[KIND_METALLIC_ROUGHNESS as usize]),
            ("rough_dielectric", self.kinds[KIND_ROUGH_DIELECTRIC as usize]),
            ("microfacets", self.kinds[KIND_METAL as usize..].contains(&true)),
            ("non_delta", non_delta(&self.kinds)),
            ("environment", self.environment),
            ("environment_map", self.environment_map),
            ("direct_light", self.direct_light),
            ("lamps", self.sphere_lights || self.quad_lights || self.triangle_lights),
            ("sphere_lights", self.sphere_lights),
            ("quad_lights", self.quad_lights),
            ("triangle_lights", self.triangle_lights),
            ("light_tree", self.light_tree),
            ("roulette", self.roulette != Roulette::Off),
            ("learnt_roulette", self.roulette == Roulette::Learnt),
            ("splits", self.places > 1),
            ("learns", self.guide.is_some()),
            ("guided", self.guided),
            ("teaches", self.teaches),
            ("adaptive", self.guide == Some(GuideMode::Adaptive)),
            ("octant", self.guide == Some(GuideMode::Octant)),
            ("bansal", self.guide.is_some_and(GuideMode::is_bansal)),
            ("reweighted", self.guide == Some(GuideMode::BansalReweighted)),
            ("stratified", self.stratified),
            ("bvh", self.bvh.is_some()),
            ("instances", self.instances.is_some()),
            ("small_scene", self.small_scene.is_some()),
            ("aligned_quads", self.small_scene.is_some_and(|s| s.aligned != [0; 3])),
            ("other_quads", self.small_scene.is_some_and(|s| s.quads > s.aligned.iter().sum())),
        ]
    }

    /// Number of hit queues: one per material kind present, one for the environment if it shines.
    pub fn hit_queues(&self) -> u32 {
        self.material_queues() + u32::from(self.environment)
    }

    /// Of these the ones of materials, which come first.
    pub fn material_queues(&self) -> u32 {
        self.kinds.iter().filter(|&&k| k).count() as u32
    }

    /// Position of a kind's queue among the hit queues.
    pub fn hit_queue(&self, kind: u32) -> u32 {
        self.kinds[..kind as usize].iter().filter(|&&k| k).count() as u32
    }
}

/// Whether any material present has a lobe that is not a delta.
fn non_delta(kinds: &[bool; KINDS]) -> bool {
    kinds.iter().enumerate().any(|(kind, &present)| present && kind as u32 != KIND_DIELECTRIC)
}

impl fmt::Display for KernelKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let on: Vec<&str> = self.flags().iter().filter(|(_, on)| *on).map(|(name, _)| *name).collect();
        f.write_str(&on.join("+"))?;
        if self.places > 1 {
            write!(f, " (splits up to {})", self.places)?;
        }
        if let Some(instances) = self.instances {
            write!(f, " ({instances} instances)")?;
        }
        match self.small_scene {
            Some(SmallScene { spheres, quads, aligned: [x, y, z] }) => {
                write!(f, " ({spheres} spheres, {quads} quads, of which aligned {x} {y} {z})")
            }
            None => Ok(()),
        }
    }
}
