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

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::mesh::{Placement, Sharing, file};
use super::validate::{self, MOST_SEEN};
use super::{Geometry, Material, Mesh, MeshData, MeshInstance, Shape, Texture};
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
    /// Surfaces that are shared, smooth or not; nothing where they had better not be.
    shared: HashMap<(usize, bool), Option<Sharing>>,
}

/// Where and how a model stands in a scene.
pub(super) struct Standing<'a> {
    pub placement: &'a Placement,
    /// Whether its normals are taken.
    pub smooth: bool,
    /// How often the scene places it so.
    pub times: usize,
    /// Whether what has that material of the model's shines: then it is not shared.
    pub emits: &'a (dyn Fn(usize) -> bool + Sync),
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

/// Triangles that are spared by sharing a surface, from which on it is: below that they take 2 MB at most, and those placed in
/// f64 are right to the last place.
const FEWEST_REPEATED: usize = 1 << 14;
/// Triangles that are read, or laid out by a model of several instances.
const MOST_TRIANGLES: usize = validate::MOST_TRIANGLES as usize;

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
    /// Instances of a surface share its triangles where that spares many and nothing stands against it; the others have their
    /// own, placed in f64.
    pub fn place(&mut self, standing: &Standing<'_>) -> Result<Vec<Shape>, String> {
        self.check_seen()?;
        self.find_shared(standing);
        let outer = standing.placement.transform();
        let shared = |instance: &Instance| {
            let sharing = self.shared.get(&(instance.surface, standing.smooth))?.as_ref()?;
            let shines = (standing.emits)(self.surfaces[instance.surface].material);
            (!shines).then_some(sharing)?.at(&(outer * instance.transform))
        };
        let shared: Vec<Option<MeshInstance>> = self.instances.par_iter().map(shared).collect();
        self.check_repeated(&shared)?;
        let place = |(instance, shared): (&Instance, Option<MeshInstance>)| {
            let geometry = match shared {
                Some(shared) => Some(Geometry::Instance(shared)),
                None => self.lay_out(instance, &outer, standing.smooth)?,
            };
            let material = self.surfaces[instance.surface].material;
            Ok(geometry.map(|geometry| Shape { name: instance.name.clone(), material, geometry }))
        };
        let placed: Vec<Option<Shape>> =
            self.instances.par_iter().zip(shared).map(place).collect::<Result<_, String>>()?;
        if !placed.is_empty() && placed.iter().all(Option::is_none) {
            return Err("has no area: its triangles are points or lines where they stand; scale it up, or move it towards the origin"
                .to_owned());
        }
        self.tell_laid_out(standing, &placed);
        let left_out = placed.iter().zip(&self.instances).filter(|(shape, _)| shape.is_none());
        for (_, instance) in left_out {
            self.findings.note(
                "has no area where it stands, so it is left out; give it a scale above 0",
                &self.surfaces[instance.surface].name,
            );
        }
        Ok(placed.into_iter().flatten().collect())
    }

    /// Notes which instances could have shared their triangles, but for what they are or where they stand.
    fn tell_laid_out(&mut self, standing: &Standing<'_>, placed: &[Option<Shape>]) {
        for (instance, shape) in self.instances.iter().zip(placed) {
            let Some(Shape { geometry: Geometry::Mesh(_), material, .. }) = shape else { continue };
            if self.shared.contains_key(&(instance.surface, standing.smooth)) && !(standing.emits)(*material)
            {
                self.findings.note(
                    "can't share its triangles with others where it stands, so it has its own; remove triangles of next to no \
                     area, keep scales between 1e-6 and 1e6 and the mesh near its origin",
                    &self.surfaces[instance.surface].name,
                );
            }
        }
    }

    /// Refuses more triangles than have numbers before any of them is placed.
    fn check_seen(&self) -> Result<(), String> {
        match self.seen() > MOST_SEEN {
            true => Err(format!(
                "has more than {MOST_SEEN} triangles, each instance counted; take instances away"
            )),
            false => Ok(()),
        }
    }

    /// Triangles, each instance counted.
    fn seen(&self) -> u64 {
        let triangles = |instance: &Instance| self.surfaces[instance.surface].data.triangles.len() as u64;
        self.instances.iter().map(triangles).sum()
    }

    /// Prepares the surfaces that are to be shared, each once.
    fn find_shared(&mut self, standing: &Standing<'_>) {
        let mut counts = vec![0; self.surfaces.len()];
        self.instances.iter().for_each(|instance| counts[instance.surface] += standing.times);
        for (number, (surface, count)) in self.surfaces.iter().zip(counts).enumerate() {
            let repeated = surface.data.triangles.len().saturating_mul(count.max(1) - 1);
            if repeated >= FEWEST_REPEATED && !(standing.emits)(surface.material) {
                let sharing = || match standing.smooth {
                    true => Sharing::new(&surface.data),
                    false => Sharing::new(&MeshData { normals: Vec::new(), ..surface.data.clone() }),
                };
                self.shared.entry((number, standing.smooth)).or_insert_with(sharing);
            }
        }
    }

    /// Refuses more triangles than fit before they are laid out, where few that are read become many.
    fn check_repeated(&self, shared: &[Option<MeshInstance>]) -> Result<(), String> {
        let laid_out = self.instances.iter().zip(shared).filter(|(_, shared)| shared.is_none());
        let triangles = laid_out.map(|(instance, _)| self.surfaces[instance.surface].data.triangles.len());
        match self.instances.len() > 1 && triangles.sum::<usize>() > MOST_TRIANGLES {
            true => Err(format!(
                "has more than {MOST_TRIANGLES} triangles, each instance counted; reduce it, take instances away, or remove triangles \
                 of next to no area: a mesh that has such can't be shared"
            )),
            false => Ok(()),
        }
    }

    /// Triangles of the instance's own; nothing if they have no area.
    fn lay_out(
        &self,
        instance: &Instance,
        outer: &DAffine3,
        smooth: bool,
    ) -> Result<Option<Geometry>, String> {
        let surface = &self.surfaces[instance.surface];
        let mut data = surface.data.transformed(&(outer * instance.transform));
        if !smooth {
            data.normals.clear();
        }
        let named = |problem| format!("{} {problem}", surface.name).trim_start().to_owned();
        Ok(Mesh::with_area(&data).map_err(named)?.map(|mesh| Geometry::Mesh(Arc::new(mesh))))
    }
}
