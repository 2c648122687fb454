//! What to render: camera, light, materials and shapes, validated, in world units, y up, right-handed, linear RGB.
//!
//! A [`Scene`] comes from a TOML or JSON file ([`Scene::load`]), from text, or from code ([`Scene::builder`]); all three
//! pass the same validation, so whoever holds one may rely on the ranges written below. Fields are public: after changing
//! one, call [`Scene::validate`].
//!
//! ```toml
//! name = "lamp in a furnace"
//! [camera]
//! origin = [0, 1, 4]
//! target = [0, 0, 0]
//! up = [0, 1, 0]              # default
//! fov_y_deg = 40
//! width = 256
//! height = 256
//! [environment]
//! radiance = [0.1, 0.1, 0.1]  # default black
//! # map = "sky.hdr"           # a .hdr or .exr file beside the scene; then radiance tints it, by default 1
//! # scale = 2                 # … times this, default 1
//! # rotate_y_deg = 90         # … and it is turned so
//! [render]
//! spp = 64                    # default, as is every key of [render]
//! [materials.white]
//! type = "diffuse"            # or mirror, glossy, dielectric, metal,
//!                             # metallic-roughness, rough-dielectric
//! color = [0.7, 0.7, 0.7]
//! [materials.lamp]
//! type = "diffuse"
//! color = [0, 0, 0]
//! emission = [15, 15, 15]
//! [[shapes]]
//! type = "sphere"             # or quad, box
//! center = [0, 2, 0]
//! radius = 0.3
//! material = "lamp"
//! [[shapes]]
//! type = "box"                # becomes six outward quads
//! center = [0, 0, 0]
//! size = [1, 1, 1]
//! rotate_y_deg = 30
//! material = "white"
//! [materials.brick]
//! type = "diffuse"
//! color = [1, 1, 1]           # default where there is a color_texture, which it multiplies
//! color_texture = "brick.png" # .png or .jpg beside the scene; also emission_texture, normal_texture
//! normal_scale = 1            # default; of normal_texture
//! texture_wrap = "repeat"     # default; or clamp, mirror
//! [[shapes]]
//! type = "mesh"               # triangles of a .ply, .obj, .gltf or .glb file beside the scene
//! file = "meshes/blob.ply"
//! smooth = true               # default where the file has normals; false ignores them
//! scale = 0.5                 # default 1, then rotate_y_deg, then translate
//! translate = [0, 1, 0]
//! material = "white"          # may be left out for .gltf and .glb, which have materials of their own
//! ```
//!
//! A .gltf, .glb, .ply or .obj file is a scene by itself, too: see [`Scene::load`].

mod boxes;
pub mod bvh;
mod bvh_build;
pub mod camera;
mod coincidence;
pub mod compiled;
pub mod environment;
pub mod instance;
pub mod light_tree;
mod mesh;
mod model;
mod ploc;
pub mod rows;
pub mod shading;
pub mod shapes;
pub mod sharing;
pub mod sky;
pub mod surfaces;
pub mod texels;
mod texture;
pub mod triangle;
pub mod two_levels;

mod builder;
mod description;
mod document;
mod error;
mod fields;
mod files;
mod load;
mod resolution;
#[cfg(test)]
mod tests;
mod validate;
mod warning;

use std::sync::Arc;

use glam::DVec3;

pub use builder::SceneBuilder;
pub use environment::EnvironmentMap;
pub use error::{Place, SceneError};
pub use mesh::{Mesh, MeshData, MeshFormat, MeshInstance, Placement, Repairs};
pub use sharing::Instancing;
pub use texture::{MaterialTextures, Texture, TextureRef, Wrap};
pub(crate) use validate::MOST_TRIANGLES;
pub use validate::check_image_size;
pub use warning::SceneWarning;

/// Everything a renderer needs to know. See the [module](self) for conventions.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// A short name, used for messages and file names.
    pub name: String,
    /// What the scene shows or tests; may be empty.
    pub description: String,
    /// Where it is seen from.
    pub camera: Camera,
    /// Radiance arriving from every direction that hits nothing; ≥ 0. With a map, what that is multiplied by.
    pub environment: DVec3,
    /// Radiance by direction.
    pub environment_map: Option<EnvironmentMap>,
    /// Sorted by name when read from a file, in order of addition when built.
    pub materials: Vec<Material>,
    /// Images that materials refer to.
    pub textures: Vec<Texture>,
    /// In the order of the file; a box has become six quads.
    pub shapes: Vec<Shape>,
    /// How it should be rendered unless asked otherwise.
    pub defaults: Defaults,
    /// What was repaired, left out or chosen when files of models were read; [`warnings`](Self::warnings) tells it too.
    pub file_warnings: Vec<SceneWarning>,
}

/// A pinhole camera. A pixel's samples cover exactly that pixel; row 0 is the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The pinhole, in world units.
    pub origin: DVec3,
    /// The point seen in the middle of the image; not the origin.
    pub target: DVec3,
    /// What is up in the image; any length above zero, not parallel to the view.
    pub up: DVec3,
    /// Full vertical opening angle in degrees, between 0 and 180, both excluded.
    pub fov_y_deg: f64,
    /// Columns, 1 to 65536.
    pub width: u32,
    /// Rows, 1 to 65536.
    pub height: u32,
}

/// Render settings that a scene recommends (`[render]` in a file).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Defaults {
    /// Samples per pixel, at least 1. 64 unless said.
    pub spp: u32,
    /// Levels of a path, 1 to 64: 1 sees emitters only. 64 unless said.
    pub max_bounces: u32,
    /// Sample lamps and the environment map directly at each hit of a material that is not smooth glass. True unless said.
    pub direct_light: bool,
    /// End faint paths early by Russian roulette, without bias. True unless said.
    pub roulette: bool,
}

impl Default for Defaults {
    fn default() -> Self {
        Self { spp: 64, max_bounces: 64, direct_light: true, roulette: true }
    }
}

/// How a surface reflects and what it emits.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Unique within the scene, not empty.
    pub name: String,
    /// How it reflects.
    pub kind: MaterialKind,
    /// Radiance leaving the side of the outward normal only; ≥ 0, black for most. Any kind may emit.
    pub emission: DVec3,
    /// Images for what it says, on quads and on meshes with texture coordinates.
    pub textures: MaterialTextures,
}

/// How a surface reflects. Colours are per channel, ≥ 0; above 1 they add energy ([`SceneWarning::AlbedoAboveOne`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MaterialKind {
    /// Lambertian, on both sides. `color` is the albedo.
    Diffuse {
        /// Albedo.
        color: DVec3,
    },
    /// A perfect mirror with probability `level`, else Lambertian; both tinted by `color`; on both sides.
    Mirror {
        /// Tint of both lobes.
        color: DVec3,
        /// Chance of perfect reflection, 0 to 1.
        level: f64,
    },
    /// A power-cosine lobe about the mirror direction, folded up at the horizon so that nothing is lost; on both sides.
    Glossy {
        /// Albedo.
        color: DVec3,
        /// 0 (hemispherical) to 1e6 (nearly a mirror).
        exponent: f64,
    },
    /// Smooth glass: reflects or refracts by Fresnel's equations.
    Dielectric {
        /// Multiplies each reflection and each refraction.
        tint: DVec3,
        /// Refractive index of the inside over the outside, 1 to 10.
        ior: f64,
    },
    /// Rough metal, on both sides: GGX microfacets (Walter et al. 2007) that reflect by Schlick's approximation. Light scatters
    /// once, so that rough ones lose some: 3 % on average at a roughness of 0.5, 40 % at 1.
    Metal {
        /// Reflectance head on; at grazing angles all is reflected.
        color: DVec3,
        /// 0 (taken for 0.032, [`SceneWarning::Smoothed`]) to 1; GGX's α is its square.
        roughness: f64,
    },
    /// glTF 2.0's metallic-roughness model (its appendix B), on both sides: a metal, or a diffuse base under a coat that
    /// reflects 4 % head on, or between the two.
    MetallicRoughness {
        /// Albedo of the base, reflectance of the metal head on.
        color: DVec3,
        /// 0 (coated base) to 1 (metal).
        metallic: f64,
        /// Of metal and coat, as in [`Metal`](MaterialKind::Metal).
        roughness: f64,
    },
    /// Rough glass: GGX microfacets that reflect or refract by Fresnel's equations (Walter et al. 2007).
    RoughDielectric {
        /// Multiplies each reflection and each refraction.
        tint: DVec3,
        /// Refractive index of the inside over the outside, 1 to 10.
        ior: f64,
        /// As in [`Metal`](MaterialKind::Metal).
        roughness: f64,
    },
}

impl MaterialKind {
    /// The colour or tint, whichever the kind has.
    pub fn color(&self) -> DVec3 {
        match *self {
            Self::Diffuse { color } | Self::Mirror { color, .. } | Self::Glossy { color, .. } => color,
            Self::Metal { color, .. } | Self::MetallicRoughness { color, .. } => color,
            Self::Dielectric { tint, .. } | Self::RoughDielectric { tint, .. } => tint,
        }
    }

    /// The roughness, 0 to 1, of kinds with microfacets.
    pub fn roughness(&self) -> Option<f64> {
        match *self {
            Self::Metal { roughness, .. }
            | Self::MetallicRoughness { roughness, .. }
            | Self::RoughDielectric { roughness, .. } => Some(roughness),
            _ => None,
        }
    }
}

impl Material {
    /// A Lambertian surface. Constructors leave the name empty: [`SceneBuilder::material`] gives it.
    pub fn diffuse(color: impl Into<DVec3>) -> Self {
        Self::of(MaterialKind::Diffuse { color: color.into() })
    }

    /// A mirror with probability `level` (0 to 1), else Lambertian.
    pub fn mirror(color: impl Into<DVec3>, level: f64) -> Self {
        Self::of(MaterialKind::Mirror { color: color.into(), level })
    }

    /// A power-cosine lobe; `exponent` 0 to 1e6.
    pub fn glossy(color: impl Into<DVec3>, exponent: f64) -> Self {
        Self::of(MaterialKind::Glossy { color: color.into(), exponent })
    }

    /// Smooth glass of refractive index `ior` (1 to 10).
    pub fn dielectric(tint: impl Into<DVec3>, ior: f64) -> Self {
        Self::of(MaterialKind::Dielectric { tint: tint.into(), ior })
    }

    /// Rough metal that reflects `color` head on; `roughness` 0 to 1.
    pub fn metal(color: impl Into<DVec3>, roughness: f64) -> Self {
        Self::of(MaterialKind::Metal { color: color.into(), roughness })
    }

    /// glTF's material; `metallic` and `roughness` 0 to 1.
    pub fn metallic_roughness(color: impl Into<DVec3>, metallic: f64, roughness: f64) -> Self {
        Self::of(MaterialKind::MetallicRoughness { color: color.into(), metallic, roughness })
    }

    /// Rough glass of refractive index `ior` (1 to 10); `roughness` 0 to 1.
    pub fn rough_dielectric(tint: impl Into<DVec3>, ior: f64, roughness: f64) -> Self {
        Self::of(MaterialKind::RoughDielectric { tint: tint.into(), ior, roughness })
    }

    /// The same material, emitting `radiance` from the side of the outward normal.
    pub fn emitting(mut self, radiance: impl Into<DVec3>) -> Self {
        self.emission = radiance.into();
        self
    }

    /// The same material with these textures.
    pub fn textured(mut self, textures: MaterialTextures) -> Self {
        self.textures = textures;
        self
    }

    /// True where some channel is emitted.
    pub fn is_emissive(&self) -> bool {
        self.emission.max_element() > 0.0
    }

    fn of(kind: MaterialKind) -> Self {
        Self { name: String::new(), kind, emission: DVec3::ZERO, textures: MaterialTextures::default() }
    }
}

/// A surface with a material.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// For messages; the six sides of a box share it.
    pub name: Option<String>,
    /// Index into [`Scene::materials`].
    pub material: usize,
    /// Where it is.
    pub geometry: Geometry,
}

/// The surfaces a renderer knows, in world units.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// A sphere; its outward normal points to the centre when `inward`.
    Sphere {
        /// Middle.
        center: DVec3,
        /// Above 0.
        radius: f64,
        /// Emit inwards, for furnaces.
        inward: bool,
    },
    /// The parallelogram `corner + s e1 + t e2`, s and t in 0..1; its outward normal is e1 × e2.
    Quad {
        /// s = t = 0.
        corner: DVec3,
        /// First edge; not zero, not parallel to the second.
        e1: DVec3,
        /// Second edge.
        e2: DVec3,
    },
    /// Triangles, each with its outward normal on the side from which its corners go counterclockwise.
    Mesh(Arc<Mesh>),
    /// The same triangles as elsewhere in the scene, at another place. It must not emit.
    Instance(MeshInstance),
}

impl Geometry {
    /// The mesh, in the world's coordinates or, of an instance, in its own.
    pub fn mesh(&self) -> Option<&Arc<Mesh>> {
        match self {
            Self::Mesh(mesh) => Some(mesh),
            Self::Instance(instance) => Some(instance.mesh()),
            Self::Sphere { .. } | Self::Quad { .. } => None,
        }
    }

    /// The box around a mesh in the world: its least and its greatest corner.
    pub fn mesh_bounds(&self) -> Option<[glam::Vec3; 2]> {
        match self {
            Self::Mesh(mesh) => Some(mesh.bounds()),
            Self::Instance(instance) => Some(instance.bounds()),
            Self::Sphere { .. } | Self::Quad { .. } => None,
        }
    }
}
