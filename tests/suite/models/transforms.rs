//! Where nodes put meshes, and which sides stay outside.

use super::builder::{CUBE, CUBE_SIDES, Gltf, Place, meshes, warnings, warns};
use crate::support::{Engine, differing_pixels, render, small};
use glam::{DVec3, Vec3};
use qtracer::Scene;
use qtracer::scene::{Material, Mesh, MeshData};
use serde_json::{Value, json};
use std::f32::consts::FRAC_1_SQRT_2;

/// A cube in a node in a node.
fn nested(outer: Value, inner: Value) -> Scene {
    let mut file = Gltf::cube();
    let mut inner = inner;
    inner["mesh"] = json!(0);
    let child = file.add("nodes", inner);
    let mut outer = outer;
    outer["children"] = json!([child]);
    file.stand(outer);
    file.scene()
}

fn corners(scene: &Scene) -> Vec<[Vec3; 3]> {
    meshes(scene)[0].triangles().collect()
}

/// The triangles of the cube after a map of its corners.
fn cube_under(map: impl Fn(Vec3) -> Vec3) -> Vec<[Vec3; 3]> {
    CUBE_SIDES.map(|side| side.map(|corner| map(Vec3::from(CUBE[corner as usize])))).to_vec()
}

/// Stretched along x and lifted by 1, then a quarter turn about z, then moved along x: worked out by hand.
fn by_hand(p: Vec3) -> Vec3 {
    Vec3::new(9.0 - p.y, 2.0 * p.x, p.z)
}

fn outer() -> Value {
    json!({ "translation": [10, 0, 0], "rotation": [0, 0, FRAC_1_SQRT_2, FRAC_1_SQRT_2] })
}

fn inner() -> Value {
    json!({ "translation": [0, 1, 0], "scale": [2, 1, 1] })
}

fn largest_difference(a: &[[Vec3; 3]], b: &[[Vec3; 3]]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs().max_element()).fold(0.0, f32::max)
}

#[test]
fn nested_nodes_place_a_cube_where_their_transforms_say() {
    let placed = nested(outer(), inner());
    assert!(largest_difference(&corners(&placed), &cube_under(by_hand)) < 2e-6);
    // The comparison notices the two the other way round.
    let swapped = nested(inner(), outer());
    assert!(largest_difference(&corners(&swapped), &cube_under(by_hand)) > 0.5);
}

#[test]
fn matrices_go_column_after_column_and_place_as_their_parts_do() {
    let columns = |matrix: [[f32; 4]; 4]| json!({ "matrix": matrix.concat() });
    let outer = columns([[0., 1., 0., 0.], [-1., 0., 0., 0.], [0., 0., 1., 0.], [10., 0., 0., 1.]]);
    let inner = columns([[2., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.], [0., 1., 0., 1.]]);
    assert_eq!(corners(&nested(outer, inner)), cube_under(by_hand));
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0, "matrix": [1, 0, 0, 10, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] }));
    assert!(file.problem().contains("nodes[0] has a matrix whose last row is not [0, 0, 0, 1]"));
}

/// Volume by the divergence theorem: negative where outer sides are inside.
fn volume(mesh: &Mesh) -> f64 {
    mesh.triangles()
        .map(|corners| corners.map(|v| v.as_dvec3()))
        .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
        .sum()
}

#[test]
fn scales_of_any_sign_keep_outer_sides_outside() {
    for scale in [[-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [2.0, -0.5, 3.0], [1.0, 1.0, 1.0]]
    {
        let scene = nested(json!({ "scale": scale }), json!({}));
        let expected: f64 = 8.0 * scale.iter().map(|x| f64::abs(*x)).product::<f64>();
        let found = volume(meshes(&scene)[0]);
        assert!((found - expected).abs() < 1e-6 * expected, "{scale:?}: {found} for {expected}");
    }
    // Two mirrors, one in the other, are none.
    let scene = nested(json!({ "scale": [-1, 1, 1] }), json!({ "scale": [1, 1, -1] }));
    assert!((volume(meshes(&scene)[0]) - 8.0).abs() < 1e-6);
}

#[test]
fn normals_stay_at_right_angles_to_sides_and_outside() {
    let mut file = Gltf::new();
    // A slope, whose normal is not stretched as its corners are.
    let positions = file.positions(&[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]);
    let normals = file.positions(&[[-FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0]; 3]);
    file.mesh(json!({ "attributes": { "POSITION": positions, "NORMAL": normals } }));
    for scale in [[1.0, 1.0, 1.0], [3.0, 1.0, 0.5], [-3.0, 1.0, 0.5], [2.0, -1.0, -1.0], [-1.0, -2.0, -3.0]] {
        let mut file = file.clone();
        file.stand(json!({ "mesh": 0, "scale": scale }));
        let scene = file.scene();
        let mesh = meshes(&scene)[0];
        let [a, b, c] = mesh.triangles().next().unwrap();
        let flat = (b - a).cross(c - a).normalize();
        for normal in mesh.normals().flatten() {
            assert!((normal - flat).length() < 1e-6, "{scale:?}: {normal} for {flat}");
        }
    }
}

/// A cube that glows on its outer sides, mirrored and turned in its node, seen by a camera of the file under the sky that
/// files without light get.
fn glowing() -> Gltf {
    let mut file = Gltf::cube();
    let material =
        json!({ "emissiveFactor": [0.9, 0.5, 0.1], "pbrMetallicRoughness": { "metallicFactor": 0 } });
    let material = file.add("materials", material);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(material);
    file.stand(json!({ "mesh": 0, "scale": [-1, 2, 0.5], "translation": [0.5, 0, 0] }));
    let camera =
        file.add("cameras", json!({ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1 } }));
    file.stand(json!({ "camera": camera, "translation": [0, 0, 8] }));
    file
}

/// The same in code: corners worked out by hand, triangles turned around.
fn glowing_by_hand() -> Scene {
    let positions =
        CUBE.map(|[x, y, z]| DVec3::new(0.5 - f64::from(x), 2.0 * f64::from(y), 0.5 * f64::from(z)));
    let triangles = CUBE_SIDES.map(|[a, b, c]| [a, c, b]).to_vec();
    let kind = glowing().scene().materials[0].kind;
    let emission = [0.9, 0.5, 0.1].map(|x: f32| f64::from(x));
    Scene::builder("by hand")
        .camera([0.0, 0.0, 8.0], [0.0, 0.0, 0.0], f64::from(0.7f32).to_degrees())
        .size(640, 480)
        .material("glowing", Material { kind, ..Material::diffuse([0.0; 3]) }.emitting(emission))
        .mesh(MeshData { positions: positions.to_vec(), triangles, ..Default::default() }, "glowing")
        .build()
        .unwrap()
}

#[test]
fn a_mirrored_cube_looks_as_the_same_one_in_code_and_in_a_scene_file() {
    let options = small(32, 24, 5);
    let film = |scene: &Scene| render(scene, Engine::Cpu, &options, 8).film;
    let whole = glowing().scene();
    let by_hand = film(&glowing_by_hand());
    assert_eq!(differing_pixels(&film(&whole), &by_hand), 0, "alone");
    let place = Place::new();
    place.write("models/cube.glb", glowing().glb());
    let text = format!(
        "name = 'a'\n[camera]\norigin = [0, 0, 8]\ntarget = [0, 0, 0]\nfov_y_deg = {}\nwidth = 640\nheight = 480\n\
         [[shapes]]\ntype = 'mesh'\nfile = 'models/cube.glb'\n",
        f64::from(0.7f32).to_degrees()
    );
    let scene = Scene::load(place.write("scene.toml", text)).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(differing_pixels(&film(&scene), &by_hand), 0, "in a scene file");
    assert!(warns(&scene, "models/cube.glb: camera \"camera 0\": not taken over"), "{:?}", warnings(&scene));
    // Inside out it is black: the comparison sees which side is outside.
    let mut inside_out = glowing();
    inside_out.json["nodes"][0]["scale"] = json!([1, 2, 0.5]);
    let indices: Vec<[u32; 3]> = CUBE_SIDES.map(|[a, b, c]| [a, c, b]).to_vec();
    let indices = inside_out.indices(&indices);
    inside_out.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    assert!(differing_pixels(&film(&inside_out.scene()), &by_hand) > 50);
}

#[test]
fn a_mesh_of_many_nodes_stands_in_each_place() {
    let mut file = Gltf::cube();
    for i in 0..3 {
        file.stand(json!({ "mesh": 0, "name": "box", "translation": [5 * i, 0, 0] }));
    }
    let scene = file.scene();
    let places: Vec<f32> = meshes(&scene).iter().map(|mesh| mesh.bounds()[0].x).collect();
    assert_eq!(places, [-1.0, 4.0, 9.0]);
    assert_eq!(scene.shapes[1].name.as_deref(), Some("box"));
}

#[test]
fn instances_without_area_are_left_out_and_told_of_once() {
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0 }));
    for _ in 0..500 {
        file.stand(json!({ "mesh": 0, "scale": [0, 1, 0] }));
    }
    let scene = file.scene();
    assert_eq!(scene.shapes.len(), 1);
    let told: Vec<String> = warnings(&scene).into_iter().filter(|text| text.contains("no area")).collect();
    let expected = "meshes[0], primitives[0] and 499 more: has no area where it stands, so it is left out; give it \
                    a scale above 0";
    assert_eq!(told, [expected]);
    // Flat, but not gone.
    let scene = nested(json!({ "scale": [1, 0, 1] }), json!({}));
    assert_eq!(meshes(&scene)[0].len(), 2, "the lid and the bottom fall together");
    let mut nothing = Gltf::cube();
    nothing.stand(json!({ "mesh": 0, "scale": [0, 0, 0] }));
    assert!(nothing.problem().contains("has no area: its triangles are points or lines"));
}

#[test]
fn a_model_in_a_scene_is_placed_behind_its_own_nodes_and_may_wear_the_scenes_material() {
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0, "translation": [1, 0, 0] }));
    let place = Place::new();
    place.write("cube.glb", file.glb());
    let scene = |lines: &str| {
        let text = format!(
            "name = 'a'\n[camera]\norigin = [0, 0, 9]\ntarget = [0, 0, 0]\nfov_y_deg = 40\nwidth = 8\nheight = 8\n\
             [environment]\nradiance = [1, 1, 1]\n[materials.red]\ntype = 'diffuse'\ncolor = [1, 0, 0]\n\
             [[shapes]]\ntype = 'mesh'\nfile = 'cube.glb'\n{lines}\n"
        );
        Scene::load(place.write("scene.toml", text)).unwrap_or_else(|e| panic!("{e}"))
    };
    let placed = scene("material = 'red'\nscale = 2\nrotate_y_deg = 90\ntranslate = [0, 0, 10]");
    let [low, high] = meshes(&placed)[0].bounds();
    // x from 0 to 2, doubled, then a quarter turn that takes x to −z, then moved.
    assert_eq!((low, high), (Vec3::new(-2.0, -2.0, 6.0), Vec3::new(2.0, 2.0, 10.0)));
    assert_eq!(placed.materials.len(), 1);
    let twice = scene("[[shapes]]\ntype = 'mesh'\nfile = 'cube.glb'\ntranslate = [5, 0, 0]");
    let names: Vec<&str> = twice.materials.iter().map(|material| material.name.as_str()).collect();
    assert_eq!(names, ["red", "cube.glb: default material"]);
    assert_eq!(twice.shapes.iter().map(|shape| shape.material).collect::<Vec<_>>(), [1, 1]);
}
