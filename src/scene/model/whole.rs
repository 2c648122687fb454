//! A model as a scene of its own: what the file does not say is chosen, and the warnings tell what.

use std::path::Path;

use glam::DVec3;

use super::lamps::RADIUS;
use super::{LampKind, Model, ModelCamera, NOTHING_TO_SHOW, Standing, gltf};
use crate::scene::error::{Fault, quoted, suggestion};
use crate::scene::mesh::Placement;
use crate::scene::{Camera, Defaults, Material, Scene, SceneError, Shape};

/// Longest side of images whose size nothing says.
const LONGEST_SIDE: f64 = 640.0;
/// Width over height where the camera does not say it.
const USUAL_ASPECT: f64 = 4.0 / 3.0;
/// Opening angle of the camera that is chosen, in degrees.
const FOV_Y_DEG: f64 = 40.0;
/// Where that camera stands, seen from the middle: to the right, above, in front.
const VIEW: DVec3 = DVec3::new(0.6, 0.45, 1.0);
/// Radiance of the sky that is chosen.
const SKY: f64 = 0.5;

/// Reads a model file as a scene, seen by the camera of that name or by its first.
pub(in crate::scene) fn load(path: &Path, camera: Option<&str>) -> Result<Scene, SceneError> {
    let refuse = |problem| SceneError::File { path: path.to_owned(), problem };
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let scene = Model::load(path).and_then(|model| whole(model, name, camera)).map_err(refuse)?;
    scene.validate().map_err(|error| error.in_file(path))?;
    Ok(scene)
}

/// Reads bytes of glTF as a scene, seen by its first camera.
pub(in crate::scene) fn gltf_in_memory(name: String, bytes: &[u8]) -> Result<Scene, SceneError> {
    let refuse = |problem: String| Fault::from(problem).of(&format!("model {}", quoted(&name)), None);
    let scene = gltf::read(bytes, None).and_then(|model| whole(model, name.clone(), None)).map_err(refuse)?;
    scene.validate()?;
    Ok(scene)
}

fn whole(mut model: Model, name: String, camera: Option<&str>) -> Result<Scene, String> {
    let emits: Vec<bool> = model.materials.iter().map(Material::is_emissive).collect();
    let emits = |material: usize| emits[material];
    let standing = Standing { placement: &Placement::default(), smooth: true, times: 1, emits: &emits };
    let mut shapes = model.place(&standing)?;
    let (middle, diagonal) = extent(&shapes)?;
    let camera = chosen_camera(&mut model, camera, middle, diagonal)?;
    step_back_lamps(&mut model, &camera, diagonal);
    add_lamps(&mut model, &mut shapes, middle, diagonal);
    let lit = shapes.iter().any(|shape| model.materials[shape.material].is_emissive());
    if !lit {
        model.findings.note("an even white sky of radiance 0.5 lights it instead", "no light");
    }
    Ok(Scene {
        name,
        description: String::new(),
        camera,
        environment: if lit { DVec3::ZERO } else { DVec3::splat(SKY) },
        environment_map: None,
        file_warnings: model.findings.warnings(""),
        materials: model.materials,
        textures: model.textures,
        shapes,
        defaults: Defaults::default(),
    })
}

/// Middle and diagonal of the box around all meshes.
fn extent(shapes: &[Shape]) -> Result<(DVec3, f64), String> {
    let bounds = shapes.iter().filter_map(|shape| shape.geometry.mesh_bounds());
    let meshes = bounds.map(|bounds| bounds.map(|corner| corner.as_dvec3()));
    match meshes.reduce(|[low, high], [a, b]| [low.min(a), high.max(b)]) {
        Some([low, high]) => Ok((0.5 * (low + high), (high - low).length())),
        None => Err(NOTHING_TO_SHOW.to_owned()),
    }
}

/// The camera of that name, the first, or one that sees everything.
fn chosen_camera(
    model: &mut Model,
    wanted: Option<&str>,
    middle: DVec3,
    diagonal: f64,
) -> Result<Camera, String> {
    let names = || model.cameras.iter().map(|camera| camera.name.as_str());
    let chosen = match wanted {
        Some(wanted) => Some(
            names()
                .position(|name| name == wanted)
                .ok_or_else(|| format!("has no camera {}{}", quoted(wanted), suggestion(wanted, names())))?,
        ),
        None => (!model.cameras.is_empty()).then_some(0),
    };
    match chosen {
        Some(number) => Ok(model.cameras[number].at(middle, diagonal)),
        None => {
            model
                .findings
                .note("the whole is seen from above right, at an opening angle of 40° instead", "no camera");
            Ok(fitting_camera(middle, diagonal))
        }
    }
}

impl ModelCamera {
    /// What is in the middle of its image is as far away as the middle of the model.
    fn at(&self, middle: DVec3, diagonal: f64) -> Camera {
        let far = self.origin.abs().max_element() * 1e-3;
        let distance = (middle - self.origin).dot(self.forward).max(1e-3 * diagonal).max(far);
        let (width, height) = image_size(self.aspect.unwrap_or(USUAL_ASPECT));
        let target = self.origin + self.forward * distance;
        Camera { origin: self.origin, target, up: self.up, fov_y_deg: self.fov_y_deg, width, height }
    }
}

/// Sees a sphere around the box, with a twentieth to spare.
fn fitting_camera(middle: DVec3, diagonal: f64) -> Camera {
    let distance = 1.05 * 0.5 * diagonal / (0.5 * FOV_Y_DEG).to_radians().sin();
    let (width, height) = image_size(USUAL_ASPECT);
    let origin = middle + VIEW.normalize() * distance;
    Camera { origin, target: middle, up: DVec3::Y, fov_y_deg: FOV_Y_DEG, width, height }
}

/// The longer side is the longest.
fn image_size(aspect: f64) -> (u32, u32) {
    let (width, height) = (LONGEST_SIDE * aspect.min(1.0), LONGEST_SIDE / aspect.max(1.0));
    (width.round().max(1.0) as u32, height.round().max(1.0) as u32)
}

/// Lamps at the camera would enclose it, and their outsides shine: they are put behind it.
fn step_back_lamps(model: &mut Model, camera: &Camera, diagonal: f64) {
    let (radius, view) = (RADIUS * diagonal, (camera.target - camera.origin).normalize());
    for lamp in model.lamps.iter_mut().filter(|lamp| lamp.kind != LampKind::Sun) {
        if lamp.position.distance(camera.origin) < 1.5 * radius {
            lamp.position = camera.origin - 2.0 * radius * view;
            model.findings.note(
                "a lamp at the camera; it stands behind it, by 1/256 of the model's diagonal",
                &lamp.name,
            );
        }
    }
}

/// Small shapes for lights that have none.
fn add_lamps(model: &mut Model, shapes: &mut Vec<Shape>, middle: DVec3, diagonal: f64) {
    for (number, lamp) in std::mem::take(&mut model.lamps).into_iter().enumerate() {
        let what = match lamp.kind {
            LampKind::Point => {
                "a light without a size; a sphere of 1/512 of the model's diagonal shines as strongly instead"
            }
            LampKind::Spot => {
                "a spot light; a small square shines as strongly straight ahead instead, and its cone is not read"
            }
            LampKind::Sun => "a sun; a far sphere as large as the sun in the sky shines as strongly instead",
        };
        model.findings.note(what, &lamp.name);
        let (geometry, mut material) = lamp.shape(middle, diagonal);
        // Numbers keep names apart from those of the file.
        material.name = format!("lamp {number}: {}", material.name);
        shapes.push(Shape { name: Some(lamp.name), material: model.materials.len(), geometry });
        model.materials.push(material);
    }
}
