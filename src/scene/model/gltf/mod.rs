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

use super::{Instance, Model, Surface};
use crate::scene::error::quoted;
use crate::scene::{Material, MaterialTextures};
use buffers::Buffers;
use nodes::Placed;
use textures::Images;

/// Triangles in a model once every instance has its own.
const MOST_TRIANGLES: usize = 1 << 25;

/// Reads a file whose external buffers lie in `folder`. `Err` says what is wrong and the remedy.
pub(super) fn read(bytes: &[u8], folder: Option<&Path>) -> Result<Model, String> {
    let mut model = Model::default();
    let (root, chunk) = container::read(bytes, &mut model.findings)?;
    let buffers = buffers::read(&root, chunk, folder)?;
    let mut images = Images::new(&root, &buffers, folder);
    model.materials = material::read(&root.materials, &mut images, &mut model.findings)?;
    if root.meshes.iter().flat_map(|mesh| &mesh.primitives).any(|primitive| primitive.material.is_none()) {
        model.materials.push(material::usual(&model.materials));
    }
    model.textures = images.all;
    let placed = nodes::walk(&root, &mut model.findings)?;
    surfaces(&mut model, &root, &buffers, &placed)?;
    lights::read(&mut model, &root, &placed);
    tell_of_rest(&mut model, &root, &placed);
    Ok(model)
}

/// Reads each primitive that stands somewhere, once, and says where.
fn surfaces(model: &mut Model, root: &Root, buffers: &Buffers<'_>, placed: &[Placed]) -> Result<(), String> {
    let mut read: HashMap<(usize, usize), Option<usize>> = HashMap::new();
    let mut triangles = 0usize;
    for Placed { node, transform } in placed {
        let Some(mesh) = root.nodes[*node].mesh.map(|mesh| mesh.value()) else { continue };
        for (part, primitive) in root.meshes[mesh].primitives.iter().enumerate() {
            let surface = match read.get(&(mesh, part)) {
                Some(&known) => known,
                None => {
                    let label = primitive_label(root, mesh, part);
                    let surface = surface(model, root, buffers, primitive, &label)
                        .map_err(|problem| format!("{label} {problem}"))?;
                    read.insert((mesh, part), surface);
                    surface
                }
            };
            let Some(surface) = surface else { continue };
            triangles += model.surfaces[surface].data.triangles.len();
            bounded(triangles)?;
            let names = [&root.nodes[*node].name, &root.meshes[mesh].name];
            let name = names.into_iter().flatten().find(|name| !name.is_empty()).cloned();
            model.instances.push(Instance { surface, transform: *transform, name });
        }
    }
    Ok(())
}

fn bounded(triangles: usize) -> Result<(), String> {
    match triangles > MOST_TRIANGLES {
        true => Err(format!(
            "has more than {MOST_TRIANGLES} triangles, each instance counted; reduce it or take instances away"
        )),
        false => Ok(()),
    }
}

/// `meshes[0] "pot", primitives[1]`.
fn primitive_label(root: &Root, mesh: usize, part: usize) -> String {
    let name = root.meshes[mesh].name.as_deref().map(|name| format!(" {}", quoted(name))).unwrap_or_default();
    format!("meshes[{mesh}]{name}, primitives[{part}]")
}

/// Reads a primitive; nothing where it has no triangles.
fn surface(
    model: &mut Model,
    root: &Root,
    buffers: &Buffers<'_>,
    primitive: &Primitive,
    label: &str,
) -> Result<Option<usize>, String> {
    let findings = &mut model.findings;
    let Some(faces) = primitive::open(root, buffers, primitive)? else {
        findings.note("is of points or lines, which are left out; give them surfaces", label);
        return Ok(None);
    };
    if faces.left_over() > 0 {
        findings.note("has corners left over behind its last triangle, which are left out", label);
    }
    bounded(faces.len())?;
    let data = faces.read()?;
    if data.triangles.is_empty() {
        findings.note("has no triangles, so it is left out", label);
        return Ok(None);
    }
    if primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty()) {
        findings.note("has morph targets, which are not read; it keeps the form of its POSITIONs", label);
    }
    if primitive.attributes.keys().any(|key| key.to_string().starts_with("COLOR_")) {
        findings.note("has colors at its corners, which are not read; its material's color is taken", label);
    }
    // The one behind those of the file stands for none.
    let mut material = primitive.material.map_or(root.materials.len(), |material| material.value());
    if data.uvs.is_empty() && model.materials[material].textures.any() {
        model
            .findings
            .note("has a material with textures, but no TEXCOORD_0; its factors are taken alone", label);
        material = untextured(&mut model.materials, material);
    }
    model.surfaces.push(Surface { name: label.to_owned(), material, data });
    Ok(Some(model.surfaces.len() - 1))
}

/// The number of that material without its textures.
fn untextured(materials: &mut Vec<Material>, material: usize) -> usize {
    let name = format!("{} (untextured)", materials[material].name);
    let known = materials.iter().position(|material| material.name == name);
    known.unwrap_or_else(|| {
        materials.push(Material {
            name,
            textures: MaterialTextures::default(),
            ..materials[material].clone()
        });
        materials.len() - 1
    })
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
