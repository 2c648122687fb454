//! Files that hold more than one mesh needs: materials, instances, cameras, lamps. glTF 2.0 (.gltf, .glb), and .ply and .obj as
//! models of one mesh.
//!
//! A [`Model`] is what a file says, in the file's units; [`Model::place`] brings it into a scene ([`placed`]), and [`whole`] makes
//! a scene of it alone.

mod findings;
mod gltf;
mod lamps;
mod names;
mod placed;
mod whole;

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::mesh::{Placement, file};
use super::{Geometry, Material, Mesh, MeshData, Shape, Texture};
use findings::Findings;
use names::Names;
pub(super) use placed::PlacedModels;
pub(super) use whole::{gltf_in_memory, load as load_whole};

/// What a file holds.
#[derive(Debug, Default)]
pub(super) struct Model {
    /// With names that differ.
    pub materials: Vec<Material>,
    /// What the materials' textures refer to.
    pub textures: Vec<Texture>,
    pub surfaces: Vec<Surface>,
    pub instances: Vec<Instance>,
    pub cameras: Vec<ModelCamera>,
    pub lamps: Vec<Lamp>,
    /// What was repaired or left out.
    pub findings: Findings,
}

/// Triangles of one material, in their own coordinates.
#[derive(Debug)]
pub(super) struct Surface {
    /// What messages call it; empty for the only one.
    pub name: String,
    /// Index into [`Model::materials`].
    pub material: usize,
    pub data: MeshData,
}

/// A surface somewhere in the model; there may be many of one.
#[derive(Debug)]
pub(super) struct Instance {
    /// Index into [`Model::surfaces`].
    pub surface: usize,
    pub transform: DAffine3,
    /// The name of what stands there, for messages.
    pub name: Option<String>,
}

/// A perspective camera.
#[derive(Debug)]
pub(super) struct ModelCamera {
    pub name: String,
    pub origin: DVec3,
    /// Of length 1.
    pub forward: DVec3,
    pub up: DVec3,
    pub fov_y_deg: f64,
    /// Width over height, if the camera has a say in it.
    pub aspect: Option<f64>,
}

/// A light without a surface.
#[derive(Debug)]
pub(super) struct Lamp {
    pub name: String,
    pub position: DVec3,
    /// Where it shines, of length 1.
    pub direction: DVec3,
    pub kind: LampKind,
    /// Candela for those that stand somewhere, lux for suns; of each channel.
    pub strength: DVec3,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LampKind {
    /// Equally into all directions.
    Point,
    /// About one direction.
    Spot,
    /// From infinitely far away.
    Sun,
}

pub(super) const NOTHING_TO_SHOW: &str =
    "has no surfaces to show; give its scene a node with a mesh of triangles";

/// Extensions of files that may be given in place of a scene.
const EXTENSIONS: [&str; 4] = ["gltf", "glb", "ply", "obj"];

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

/// Whether a file of that name holds a model, which is a scene of its own.
pub(super) fn is_model(path: &Path) -> bool {
    EXTENSIONS.contains(&extension(path).as_str())
}

/// Whether a file of that name may have materials of its own.
fn has_materials(path: &Path) -> bool {
    matches!(extension(path).as_str(), "gltf" | "glb")
}

impl Model {
    /// Reads a file by its extension. `Err` says what is wrong and the remedy.
    pub fn load(path: &Path) -> Result<Model, String> {
        match has_materials(path) {
            true => gltf::read(&file::MESHES.bytes(path, u64::MAX)?, path.parent()),
            false => Ok(Model::of_mesh(file::read(path)?)),
        }
    }

    /// Grey, as it is.
    fn of_mesh(data: MeshData) -> Model {
        let grey = Material { name: "grey".to_owned(), ..Material::diffuse([0.7; 3]) };
        Model {
            materials: vec![grey],
            surfaces: vec![Surface { name: String::new(), material: 0, data }],
            instances: vec![Instance { surface: 0, transform: DAffine3::IDENTITY, name: None }],
            ..Model::default()
        }
    }

    /// The surfaces in world units, one shape for each instance, whose materials are numbers of the model's; with their normals
    /// if they are to be smooth. Instances without an area are left out.
    ///
    /// Each instance becomes triangles of its own. This is the place where shared ones would be kept: a [`Surface`] is what
    /// instances have in common, an [`Instance`] what they differ in.
    pub fn place(&mut self, placement: &Placement, smooth: bool) -> Result<Vec<Shape>, String> {
        let Model { surfaces, instances, findings, .. } = self;
        let outer = placement.transform();
        let lay_out = |instance: &Instance| -> Result<Option<Shape>, String> {
            let surface = &surfaces[instance.surface];
            let mut data = surface.data.transformed(&(outer * instance.transform));
            if !smooth {
                data.normals.clear();
            }
            let named = |problem| format!("{} {problem}", surface.name).trim_start().to_owned();
            let shape = |mesh| Shape {
                name: instance.name.clone(),
                material: surface.material,
                geometry: Geometry::Mesh(Arc::new(mesh)),
            };
            Ok(Mesh::with_area(&data).map_err(named)?.map(shape))
        };
        let laid_out: Vec<_> = instances.par_iter().map(lay_out).collect::<Result<_, String>>()?;
        if !laid_out.is_empty() && laid_out.iter().all(Option::is_none) {
            return Err("has no area: its triangles are points or lines where they stand; scale it up, or move it towards the origin"
                .to_owned());
        }
        let mut shapes = Vec::with_capacity(laid_out.len());
        for (shape, instance) in laid_out.into_iter().zip(instances) {
            match shape {
                Some(shape) => shapes.push(shape),
                None => findings.note(
                    "has no area where it stands, so it is left out; give it a scale above 0",
                    &surfaces[instance.surface].name,
                ),
            }
        }
        Ok(shapes)
    }
}
