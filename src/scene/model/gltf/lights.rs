//! What nodes carry beside meshes: cameras and KHR_lights_punctual.

use ::gltf::json::Root;
use ::gltf::json::extensions::scene::khr_lights_punctual::{Light, Type};
use ::gltf::json::validation::Checked;
use glam::{DAffine3, DVec3};

use super::nodes::{Placed, label};
use crate::scene::model::findings::Findings;
use crate::scene::model::{Lamp, LampKind, Model, ModelCamera};

/// Reads the cameras and lights of the nodes that are shown.
pub(super) fn read(model: &mut Model, root: &Root, placed: &[Placed]) {
    for Placed { node, transform } in placed {
        let place = label(root, *node);
        if let Some(camera) = root.nodes[*node].camera {
            let name = camera_name(root, *node, model.cameras.len());
            let found = camera_at(root, camera.value(), transform, name, &place, &mut model.findings);
            model.cameras.extend(found);
        }
        let extensions = root.nodes[*node].extensions.as_ref();
        let Some(carried) = extensions.and_then(|extensions| extensions.khr_lights_punctual.as_ref()) else {
            continue;
        };
        let Some(light) = root.get(carried.light) else { continue };
        model.lamps.extend(lamp(light, transform, &place, &mut model.findings));
    }
}

/// The node's name, else the camera's, else its number among those of the scene.
fn camera_name(root: &Root, node: usize, number: usize) -> String {
    let own = root.nodes[node].camera.and_then(|camera| root.cameras[camera.value()].name.as_ref());
    let names = [root.nodes[node].name.as_ref(), own];
    let name = names.into_iter().flatten().find(|name| !name.is_empty());
    name.cloned().unwrap_or_else(|| format!("camera {number}"))
}

/// Cameras look along −z, with +y up, and are not scaled.
fn camera_at(
    root: &Root,
    camera: usize,
    transform: &DAffine3,
    name: String,
    place: &str,
    findings: &mut Findings,
) -> Option<ModelCamera> {
    let Some(perspective) = &root.cameras[camera].perspective else {
        findings.note("is an orthographic camera, which is left out; make it a perspective one", place);
        return None;
    };
    let forward = (-transform.matrix3.z_axis).normalize_or_zero();
    let up = transform.matrix3.y_axis.normalize_or_zero();
    let fov_y_deg = f64::from(perspective.yfov).to_degrees();
    if forward.cross(up).length() < 1e-6 || !(1e-3..=179.0).contains(&fov_y_deg) {
        findings.note("is a camera that sees nothing (of scale 0, or of no angle between 0 and 180°), so it is left out", place);
        return None;
    }
    let aspect = perspective.aspect_ratio.map(f64::from).filter(|aspect| (1e-2..=1e2).contains(aspect));
    Some(ModelCamera { name, origin: transform.translation, forward, up, fov_y_deg, aspect })
}

/// Lights shine along −z, and are not scaled.
fn lamp(light: &Light, transform: &DAffine3, place: &str, findings: &mut Findings) -> Option<Lamp> {
    let kind = match light.type_ {
        Checked::Valid(Type::Point) => LampKind::Point,
        Checked::Valid(Type::Spot) => LampKind::Spot,
        Checked::Valid(Type::Directional) => LampKind::Sun,
        Checked::Invalid => return None,
    };
    let strength = DVec3::from_array(light.color.map(f64::from)) * f64::from(light.intensity);
    let direction = (-transform.matrix3.z_axis).normalize_or_zero();
    let aimed = kind == LampKind::Point || direction != DVec3::ZERO;
    if !strength.is_finite() || strength.min_element() < 0.0 || !aimed {
        findings.note("is a light of negative or infinite strength, or of scale 0, so it is left out", place);
        return None;
    }
    (strength != DVec3::ZERO).then(|| Lamp {
        name: place.to_owned(),
        position: transform.translation,
        direction: if aimed && direction != DVec3::ZERO { direction } else { DVec3::NEG_Z },
        kind,
        strength,
    })
}
