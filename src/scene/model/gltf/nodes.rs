//! The tree of nodes: where each of the scene's nodes stands in the world.

use ::gltf::json::Root;
use ::gltf::json::scene::Node;
use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};

use crate::scene::error::quoted;
use crate::scene::model::findings::Findings;

/// A node by its number, and what takes its coordinates to the world's.
pub(super) struct Placed {
    pub node: usize,
    pub transform: DAffine3,
}

/// The nodes of the file's scene, parents before their children, in the order of the file.
pub(super) fn walk(root: &Root, findings: &mut Findings) -> Result<Vec<Placed>, String> {
    let mut waiting: Vec<Placed> = Vec::new();
    let enter = |waiting: &mut Vec<Placed>, nodes: &mut dyn DoubleEndedIterator<Item = usize>, transform| {
        waiting.extend(nodes.rev().map(|node| Placed { node, transform }));
    };
    enter(&mut waiting, &mut roots(root, findings)?.into_iter(), DAffine3::IDENTITY);
    let mut met = vec![false; root.nodes.len()];
    let mut placed = Vec::new();
    while let Some(Placed { node, transform: parent }) = waiting.pop() {
        if std::mem::replace(&mut met[node], true) {
            return Err(format!(
                "{} is met twice below the scene, so its nodes are no tree (a cycle, or a node with two parents); write it anew",
                label(root, node)
            ));
        }
        let own =
            local(root, node, findings).map_err(|problem| format!("{} {problem}", label(root, node)))?;
        let transform = parent * own;
        if !transform.is_finite() {
            return Err(format!("{} stands infinitely far away; give it smaller numbers", label(root, node)));
        }
        let children = root.nodes[node].children.iter().flatten().map(|child| child.value());
        enter(&mut waiting, &mut children.collect::<Vec<_>>().into_iter(), transform);
        placed.push(Placed { node, transform });
    }
    Ok(placed)
}

/// `nodes[3] "lid"`.
pub(super) fn label(root: &Root, node: usize) -> String {
    match root.nodes.get(node).and_then(|node| node.name.as_deref()) {
        Some(name) => format!("nodes[{node}] {}", quoted(name)),
        None => format!("nodes[{node}]"),
    }
}

/// The roots of the scene that the file shows; of a file without scenes, the nodes without parents.
fn roots(root: &Root, findings: &mut Findings) -> Result<Vec<usize>, String> {
    let shown = root.scene.map_or(0, |scene| scene.value());
    if root.scenes.len() > 1 {
        findings.note(
            "only one is shown; move what you want to see into it",
            format_args!("{} scenes", root.scenes.len()),
        );
    }
    if let Some(scene) = root.scenes.get(shown) {
        return Ok(scene.nodes.iter().map(|node| node.value()).collect());
    }
    let mut is_child = vec![false; root.nodes.len()];
    root.nodes
        .iter()
        .flat_map(|node| node.children.iter().flatten())
        .for_each(|child| is_child[child.value()] = true);
    let roots: Vec<usize> = (0..root.nodes.len()).filter(|&node| !is_child[node]).collect();
    match roots.is_empty() && !root.nodes.is_empty() {
        true => Err("has nodes in a cycle; write it anew".to_owned()),
        false => Ok(roots),
    }
}

/// What takes a node's coordinates to its parent's.
fn local(root: &Root, number: usize, findings: &mut Findings) -> Result<DAffine3, String> {
    let node: &Node = &root.nodes[number];
    if let Some(matrix) = node.matrix {
        // Column after column.
        let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
        let last_row = matrix.row(3);
        return match (last_row - DVec4::W).abs().max_element() < 1e-6 {
            true => Ok(DAffine3::from_mat4(matrix)),
            false => {
                Err("has a matrix whose last row is not [0, 0, 0, 1]; use translation, rotation and scale"
                    .to_owned())
            }
        };
    }
    let vector =
        |given: Option<[f32; 3]>, usual: DVec3| given.map_or(usual, |v| DVec3::from_array(v.map(f64::from)));
    let rotation =
        node.rotation.map_or(DQuat::IDENTITY, |rotation| DQuat::from_array(rotation.0.map(f64::from)));
    if rotation.length_squared() == 0.0 {
        findings.note("has a rotation of all zeros, taken as none", label(root, number));
    }
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    let (scale, translation) = (vector(node.scale, DVec3::ONE), vector(node.translation, DVec3::ZERO));
    Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
}
