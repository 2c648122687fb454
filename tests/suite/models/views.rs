//! Cameras and lights of files, and those that are chosen where there are none.

use super::builder::{Gltf, Place, warns};
use crate::support::{Engine, render, small};
use glam::DVec3;
use qtracer::Scene;
use qtracer::scene::{Geometry, Material};
use serde_json::{Value, json};
use std::f32::consts::FRAC_1_SQRT_2;
use std::f64::consts::PI;

fn perspective(extra: Value) -> Value {
    let mut lens = json!({ "yfov": 0.5, "znear": 0.1 });
    lens.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
    json!({ "type": "perspective", "perspective": lens })
}

#[test]
fn a_camera_looks_along_minus_z_of_its_node() {
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0 }));
    let camera = file.add("cameras", perspective(json!({ "aspectRatio": 2.0 })));
    // A quarter turn about y takes −z to −x; the scale of the node is not the camera's.
    let turn = json!({ "camera": camera, "translation": [5, 1, 0], "rotation": [0, FRAC_1_SQRT_2, 0, FRAC_1_SQRT_2], "scale": [3, 3, 3] });
    file.stand(turn);
    let camera = file.scene().camera;
    assert_eq!(camera.origin, DVec3::new(5.0, 1.0, 0.0));
    let forward = (camera.target - camera.origin).normalize();
    assert!((forward - DVec3::NEG_X).length() < 1e-6 && (camera.up - DVec3::Y).length() < 1e-6, "{camera:?}");
    assert!((camera.fov_y_deg - 0.5f64.to_degrees()).abs() < 1e-12);
    assert_eq!((camera.width, camera.height), (640, 320));
}

#[test]
fn cameras_are_chosen_by_name_and_the_first_unless_one_is() {
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0 }));
    let own = json!({ "type": "perspective", "name": "lens", "perspective": { "yfov": 1.0, "znear": 1 } });
    let (tall, named) =
        (file.add("cameras", perspective(json!({ "aspectRatio": 0.5 }))), file.add("cameras", own));
    file.stand(json!({ "camera": tall, "name": "from above", "translation": [0, 9, 0] }));
    file.stand(json!({ "camera": named, "translation": [0, 0, 7] }));
    file.stand(json!({ "camera": tall, "translation": [0, 0, 8] }));
    let place = Place::new();
    let path = place.write("a.glb", file.glb());
    assert_eq!(Scene::load(&path).unwrap().camera.origin, DVec3::Y * 9.0);
    for (name, z) in [("lens", 7.0), ("camera 2", 8.0)] {
        let scene = Scene::load_with_camera(&path, name).unwrap();
        assert_eq!(scene.camera.origin, DVec3::Z * z, "{name}");
    }
    let error = Scene::load_with_camera(&path, "form above").unwrap_err().to_string();
    assert!(error.ends_with("a.glb: has no camera \"form above\"; did you mean \"from above\"?"), "{error}");
    let toml = crate::support::root().join("scenes/cornell-box.toml");
    assert!(Scene::load_with_camera(toml, "x").unwrap_err().to_string().contains("has one camera"));
}

#[test]
fn without_a_camera_all_is_seen_and_without_a_light_there_is_a_sky() {
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0, "translation": [1e4, 0, 3], "scale": [1, 9, 1] }));
    let ortho =
        json!({ "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "zfar": 9, "znear": 1 } });
    let ortho = file.add("cameras", ortho);
    file.stand(json!({ "camera": ortho }));
    let scene = file.scene();
    let camera = scene.camera;
    let forward = (camera.target - camera.origin).normalize();
    let right = forward.cross(camera.up).normalize();
    let half = (camera.fov_y_deg.to_radians() * 0.5).tan();
    for corner in super::builder::CUBE {
        let [x, y, z] = corner.map(f64::from);
        let seen = DVec3::new(1e4 + x, 9.0 * y, 3.0 + z) - camera.origin;
        let depth = seen.dot(forward);
        let [across, along] = [right, right.cross(forward)].map(|axis| seen.dot(axis) / depth / half);
        assert!(depth > 0.0 && along.abs() < 1.0 && across.abs() < 4.0 / 3.0, "{corner:?}: {across} {along}");
    }
    assert_eq!(scene.environment, DVec3::splat(0.5));
    for words in ["orthographic camera", "no camera: the whole is seen", "no light: an even white sky"] {
        assert!(warns(&scene, words), "{words}");
    }
    assert_eq!((scene.camera.width, scene.camera.height, scene.defaults.spp), (640, 480, 64));
}

/// Radiance of a white floor under the one light of a file, straight below it, from paths that see it directly; and its
/// standard error.
fn floor_under(light: Value, node: Value) -> (Scene, f64, f64) {
    let mut file = Gltf::new();
    let corners = [[-4.0, 0.0, 4.0], [4.0, 0.0, 4.0], [4.0, 0.0, -4.0], [-4.0, 0.0, -4.0]];
    let positions = file.positions(&corners);
    let indices = file.indices(&[[0, 1, 2], [0, 2, 3]]);
    file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    file.stand(json!({ "mesh": 0 }));
    file.light(light, node);
    let camera =
        file.add("cameras", json!({ "type": "perspective", "perspective": { "yfov": 0.001, "znear": 0.1 } }));
    file.stand(json!({ "camera": camera, "translation": [1, 1, 0], "rotation": turn_onto([1.0, 1.0]) }));
    let mut scene = file.scene();
    scene.materials[0] = Material { name: "white".into(), ..Material::diffuse([1.0; 3]) };
    let film = render(&scene, Engine::Cpu, &small(8, 8, 3), 256).film;
    let [mean, error] = mean_of(&film);
    (scene, mean, error)
}

/// A turn that makes −z look from (x, y, 0) at the origin: about z to the vertical plane, and down.
fn turn_onto([x, y]: [f64; 2]) -> [f64; 4] {
    let from = DVec3::NEG_Z;
    let q = glam::DQuat::from_rotation_arc(from, DVec3::new(-x, -y, 0.0).normalize());
    q.to_array()
}

fn mean_of(film: &qtracer::film::Film) -> [f64; 2] {
    let pixels = film.pixels();
    let count: f64 = pixels.iter().map(|pixel| pixel.count as f64).sum();
    let sum: f64 = pixels.iter().map(|pixel| pixel.sum[1]).sum();
    let squares: f64 = pixels.iter().map(|pixel| pixel.sum_sq[1]).sum();
    let mean = sum / count;
    [mean, ((squares / count - mean * mean).max(0.0) / count).sqrt()]
}

/// Within five standard errors (α = 6e-7), and the share that the form of the lamp may differ by.
fn agrees([mean, error]: [f64; 2], expected: f64, share: f64) {
    println!("{mean} ± {error} for {expected}");
    let far = (mean - expected).abs();
    assert!(far < 5.0 * error + share * expected, "{mean} ± {error} for {expected}");
    assert!(error < 0.01 * expected, "{error} is too large to tell anything");
}

#[test]
fn point_lights_give_a_floor_their_intensity_over_the_squared_distance() {
    let light = json!({ "type": "point", "intensity": 60.0, "color": [1.0, 0.5, 0.25] });
    let (scene, mean, error) = floor_under(light, json!({ "translation": [0, 3, 0], "scale": [7, 7, 7] }));
    // A sphere's irradiance straight below is exactly that of a point of its intensity.
    agrees([mean, error], 0.5 * 60.0 / 9.0 / PI, 1e-5);
    let lamp = scene.shapes.last().unwrap();
    let Geometry::Sphere { radius, .. } = lamp.geometry else { panic!("a sphere") };
    assert!((radius - 128f64.sqrt() / 512.0).abs() < 1e-12, "{radius}");
    let emission = scene.materials[lamp.material].emission;
    assert!((emission * PI * radius * radius - DVec3::new(60.0, 30.0, 15.0)).length() < 1e-9);
    assert!(warns(&scene, "a light without a size"), "{:?}", scene.file_warnings);
}

/// It would enclose the camera, which would see its dark inside and nothing else.
#[test]
fn a_light_at_the_camera_stands_behind_it() {
    let light = json!({ "type": "point", "intensity": 60.0 });
    let (scene, mean, error) = floor_under(light, json!({ "translation": [1, 1, 0] }));
    let distance = 2f64.sqrt() + 2.0 * 128f64.sqrt() / 512.0;
    agrees([mean, error], 60.0 * f64::from(FRAC_1_SQRT_2) / (distance * distance) / PI, 1e-3);
    assert!(warns(&scene, "a lamp at the camera"), "{:?}", scene.file_warnings);
}

#[test]
fn spot_lights_give_what_they_face_their_intensity_and_nothing_behind() {
    let light = json!({ "type": "spot", "intensity": 60.0, "spot": { "outerConeAngle": 0.5 } });
    let down = json!([-FRAC_1_SQRT_2, 0, 0, FRAC_1_SQRT_2]);
    let (scene, mean, error) =
        floor_under(light.clone(), json!({ "translation": [0, 3, 0], "rotation": down }));
    agrees([mean, error], 60.0 / 9.0 / PI, 1.5e-4);
    assert!(warns(&scene, "its cone is not read"));
    let up = json!([FRAC_1_SQRT_2, 0, 0, FRAC_1_SQRT_2]);
    let (_, mean, _) = floor_under(light, json!({ "translation": [0, 3, 0], "rotation": up }));
    assert_eq!(mean, 0.0);
}

#[test]
fn suns_give_a_floor_their_illuminance() {
    let light = json!({ "type": "directional", "intensity": 100.0, "color": [1, 1, 1] });
    let down = json!([-FRAC_1_SQRT_2, 0, 0, FRAC_1_SQRT_2]);
    let (scene, mean, error) =
        floor_under(light.clone(), json!({ "rotation": down, "translation": [5, -80, 0] }));
    agrees([mean, error], 100.0 / PI, 1e-5);
    let Geometry::Sphere { center, radius, .. } = scene.shapes.last().unwrap().geometry else {
        panic!("a sphere")
    };
    assert!(center.y > 1e4 && center.x.abs() < 1e-2 * center.y, "{center}");
    let half_angle = (radius / center.length()).asin().to_degrees();
    assert!((half_angle - 0.2666).abs() < 1e-4, "{half_angle}");
    // Under 60° from the zenith, half as much.
    let half = glam::DQuat::from_rotation_x(-PI / 6.0).to_array();
    let (_, mean, error) = floor_under(light, json!({ "rotation": half }));
    agrees([mean, error], 100.0 / PI * 0.5, 1e-5);
}
