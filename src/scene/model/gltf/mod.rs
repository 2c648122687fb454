//! glTF 2.0: .gltf with its buffers, and .glb. The `gltf` crate parses and checks the description; see [`container`].

mod accessor;
mod buffers;
mod container;
mod extensions;
mod lights;
mod material;
mod nodes;
mod primitive;
mod textures;

use std::collections::HashMap;
use std::path::Path;

use ::gltf::json::Root;
use ::gltf::json::mesh::Primitive;

use super::{Instance, MOST_TRIANGLES, Model, Names, Surface};
use crate::scene::error::quoted;
use crate::scene::{Material, MaterialTextures};
use buffers::Buffers;
use nodes::Placed;
use textures::Images;

/// Primitives in a model once every node has its own, with and without triangles.
const MOST_PRIMITIVES: usize = 1 << 20;
/// Characters of names that are kept: every instance has its own copy.
const LONGEST_NAME: usize = 100;

/// Reads a file whose external buffers lie in `folder`. `Err` says what is wrong and the remedy.
pub(super) fn read(bytes: &[u8], folder: Option<&Path>) -> Result<Model, String> {
    let mut model = Model::default();
    let (root, chunk) = container::read(bytes, &mut model.findings)?;
    let buffers = buffers::read(&root, chunk, folder)?;
    let (mut images, mut names) = (Images::new(&root, &buffers, folder), Names::default());
    model.materials = material::read(&root.materials, &mut names, &mut images, &mut model.findings)?;
    if root.meshes.iter().flat_map(|mesh| &mesh.primitives).any(|primitive| primitive.material.is_none()) {
        model.materials.push(material::usual(&mut names));
    }
    model.textures = images.all;
    let placed = nodes::walk(&root, &mut model.findings)?;
    Surfaces::new(&mut model, &root, &buffers, names).read(&placed)?;
    lights::read(&mut model, &root, &placed);
    tell_of_rest(&mut model, &root, &placed);
    Ok(model)
}

/// Surfaces in the making.
struct Surfaces<'a> {
    model: &'a mut Model,
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    /// By mesh and place in it: the number of the surface, nothing where there are no triangles.
    known: HashMap<(usize, usize), Option<usize>>,
    /// Of the materials.
    names: Names,
    /// Numbers of materials without their textures, by those with them.
    untextured: HashMap<usize, usize>,
    /// Read so far.
    triangles: usize,
    /// So far, each instance counted.
    primitives: usize,
}

impl<'a> Surfaces<'a> {
    fn new(model: &'a mut Model, root: &'a Root, buffers: &'a Buffers<'a>, names: Names) -> Self {
        let (known, untextured) = (HashMap::new(), HashMap::new());
        Surfaces { model, root, buffers, known, names, untextured, triangles: 0, primitives: 0 }
    }

    /// Reads each primitive that stands somewhere, once, and says where.
    fn read(&mut self, placed: &[Placed]) -> Result<(), String> {
        let root = self.root;
        for Placed { node, transform } in placed {
            let Some(mesh) = root.nodes[*node].mesh.map(|mesh| mesh.value()) else { continue };
            let names = [&root.nodes[*node].name, &root.meshes[mesh].name];
            let name = names.into_iter().flatten().find(|name| !name.is_empty()).map(|name| cut(name));
            for (part, primitive) in root.meshes[mesh].primitives.iter().enumerate() {
                if let Some(surface) = self.stands(mesh, part, primitive)? {
                    let name = name.clone();
                    self.model.instances.push(Instance { surface, transform: *transform, name });
                }
            }
        }
        Ok(())
    }

    /// Counts a primitive that stands somewhere, and reads it if it is new.
    fn stands(&mut self, mesh: usize, part: usize, primitive: &Primitive) -> Result<Option<usize>, String> {
        self.primitives += 1;
        if self.primitives > MOST_PRIMITIVES {
            return Err(format!(
                "has more than {MOST_PRIMITIVES} primitives, each instance counted; join them or take instances away"
            ));
        }
        if let Some(&surface) = self.known.get(&(mesh, part)) {
            return Ok(surface);
        }
        let label = primitive_label(self.root, mesh, part);
        let surface = self.surface(primitive, &label).map_err(|problem| format!("{label} {problem}"))?;
        self.known.insert((mesh, part), surface);
        Ok(surface)
    }

    /// Refuses too many to read; those that tie strips together count as well.
    fn count(&mut self, triangles: usize) -> Result<(), String> {
        self.triangles = self.triangles.saturating_add(triangles);
        match self.triangles > MOST_TRIANGLES {
            true => Err(format!("has more than {MOST_TRIANGLES} triangles; reduce it")),
            false => Ok(()),
        }
    }

    /// Reads a primitive; nothing where it has no triangles.
    fn surface(&mut self, primitive: &Primitive, label: &str) -> Result<Option<usize>, String> {
        let Some(faces) = primitive::open(self.root, self.buffers, primitive)? else {
            let what = "is of points or lines, which are left out; give them surfaces";
            self.model.findings.note(what, label);
            return Ok(None);
        };
        self.count(faces.len())?;
        let findings = &mut self.model.findings;
        if faces.left_over() > 0 {
            findings.note("has corners left over behind its last triangle, which are left out", label);
        }
        let data = faces.read()?;
        if data.triangles.is_empty() {
            findings.note("has no triangles, so it is left out", label);
            return Ok(None);
        }
        if primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty()) {
            findings.note("has morph targets, which are not read; it keeps the form of its POSITIONs", label);
        }
        if primitive.attributes.keys().any(|key| key.to_string().starts_with("COLOR_")) {
            findings
                .note("has colors at its corners, which are not read; its material's color is taken", label);
        }
        // The one behind those of the file stands for none.
        let mut material = primitive.material.map_or(self.root.materials.len(), |material| material.value());
        if data.uvs.is_empty() && self.model.materials[material].textures.any() {
            findings
                .note("has a material with textures, but no TEXCOORD_0; its factors are taken alone", label);
            material = self.untextured(material);
        }
        self.model.surfaces.push(Surface { name: label.to_owned(), material, data });
        Ok(Some(self.model.surfaces.len() - 1))
    }

    /// The number of that material without its textures.
    fn untextured(&mut self, material: usize) -> usize {
        let materials = &mut self.model.materials;
        *self.untextured.entry(material).or_insert_with(|| {
            let name = self.names.fresh(format!("{} (untextured)", materials[material].name));
            let textures = MaterialTextures::default();
            materials.push(Material { name, textures, ..materials[material].clone() });
            materials.len() - 1
        })
    }
}

/// As much of a name as is kept.
fn cut(name: &str) -> String {
    match name.char_indices().nth(LONGEST_NAME) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.to_owned(),
    }
}

/// `meshes[0] "pot", primitives[1]`.
fn primitive_label(root: &Root, mesh: usize, part: usize) -> String {
    let name = root.meshes[mesh].name.as_deref().map(|name| format!(" {}", quoted(name))).unwrap_or_default();
    format!("meshes[{mesh}]{name}, primitives[{part}]")
}

fn tell_of_rest(model: &mut Model, root: &Root, placed: &[Placed]) {
    if !root.animations.is_empty() {
        model.findings.note(
            "not played; nodes stand as the file places them",
            format_args!("{} animations", root.animations.len()),
        );
    }
    for Placed { node, .. } in placed.iter().filter(|placed| root.nodes[placed.node].skin.is_some()) {
        let place = nodes::label(root, *node);
        model.findings.note("has a skin, which is not read; it keeps the form of its POSITIONs", place);
    }
}
