//! What valid descriptions mean.

use glam::DVec3;

use super::ROOM;
use crate::scene::{Defaults, Geometry, Material, MaterialKind, Scene, SceneWarning, Shape};

fn room() -> Scene {
    Scene::from_toml(ROOM).expect("the room is valid")
}

#[test]
fn defaults_fill_what_is_left_out() {
    let scene = room();
    assert_eq!(scene.camera.up, DVec3::Y);
    assert_eq!(scene.environment, DVec3::ZERO);
    assert_eq!(scene.defaults, Defaults { spp: 16, max_bounces: 64, direct_light: true, roulette: true });
    assert_eq!(scene.description, "");
    let glass = &scene.materials[0];
    assert_eq!(
        (glass.name.as_str(), glass.kind),
        ("glass", MaterialKind::Dielectric { tint: DVec3::ONE, ior: 1.5 })
    );
    assert_eq!(scene.warnings(), []);
}

#[test]
fn rough_materials_say_what_they_are() {
    let rough = |lines: &str| {
        let text = ROOM.replace("type = \"dielectric\"\nior = 1.5", lines);
        Scene::from_toml(&text).map(|scene| (scene.materials[0].kind, scene.warnings()))
    };
    let (color, tint) = (DVec3::new(0.9, 0.8, 0.7), DVec3::ONE);
    let metal = rough("type = \"metal\"\ncolor = [0.9, 0.8, 0.7]\nroughness = 0.25");
    assert_eq!(metal, Ok((MaterialKind::Metal { color, roughness: 0.25 }, vec![])));
    let gltf = "type = \"metallic-roughness\"\ncolor = [0.9, 0.8, 0.7]\nmetallic = 0.5\nroughness = 1";
    assert_eq!(
        rough(gltf),
        Ok((MaterialKind::MetallicRoughness { color, metallic: 0.5, roughness: 1.0 }, vec![]))
    );
    let glass = rough("type = \"rough-dielectric\"\nior = 1.3\nroughness = 0.5");
    assert_eq!(glass, Ok((MaterialKind::RoughDielectric { tint, ior: 1.3, roughness: 0.5 }, vec![])));
    let (_, warnings) = rough("type = \"metal\"\ncolor = [1, 1, 1]\nroughness = 0.01").unwrap();
    let [warning] = &warnings[..] else { panic!("{warnings:?}") };
    assert_eq!(
        warning.to_string(),
        "material \"glass\": a roughness of 0.01 is taken for 0.032, below which highlights are too narrow for 32 bits; \
         for perfect smoothness use a mirror or a dielectric"
    );
}

#[test]
fn shapes_refer_to_their_materials_by_index() {
    let scene = room();
    let names: Vec<_> =
        scene.shapes.iter().map(|shape| scene.materials[shape.material].name.as_str()).collect();
    assert_eq!(names, ["white", "lamp", "glass", "glass", "glass", "glass", "glass", "glass"]);
}

#[test]
fn toml_and_json_give_the_same_scene() {
    let value: toml::Value = toml::from_str(ROOM).expect("valid TOML");
    let json = serde_json::to_string(&value).expect("finite numbers");
    assert_eq!(Scene::from_json(&json), Ok(room()));
}

#[test]
fn a_byte_order_mark_is_ignored() {
    assert_eq!(Scene::from_toml(&format!("\u{feff}{ROOM}")), Ok(room()));
}

#[test]
fn building_gives_what_the_file_gives() {
    let built = Scene::builder("room")
        .camera([0.0, 1.0, 4.0], [0.0; 3], 40.0)
        .size(320, 240)
        .render(Defaults { spp: 16, ..Defaults::default() })
        .material("glass", Material::dielectric([1.0; 3], 1.5))
        .material("lamp", Material::diffuse([0.0; 3]).emitting([15.0; 3]))
        .material("polished", Material::mirror([0.9; 3], 0.5))
        .material("shiny", Material::glossy([0.5; 3], 20.0))
        .material("white", Material::diffuse([0.7; 3]))
        .quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], "white")
        .sphere([0.0, 3.0, 0.0], 0.5, "lamp")
        .named("lamp")
        .boxed([0.0, 1.0, 0.0], [1.0, 2.0, 3.0], 0.0, "glass")
        .build();
    assert_eq!(built, Ok(room()));
}

/// Each side's centre lies half a size from the box's, along the side's own normal, and areas and volume are right.
#[test]
fn boxes_become_six_outward_quads() {
    let (center, size) = (DVec3::new(1.0, -2.0, 3.0), DVec3::new(2.0, 4.0, 6.0));
    for degrees in [0.0, 30.0, 90.0, -135.0, 720.5] {
        let shapes = boxed(center, size, degrees);
        let mut volume = 0.0;
        let mut closed = DVec3::ZERO;
        for shape in &shapes {
            let Geometry::Quad { corner, e1, e2 } = shape.geometry else { panic!("not a quad") };
            let area = e1.cross(e2);
            let reach = (corner + 0.5 * (e1 + e2) - center).dot(area.normalize());
            assert!(reach > 0.9, "a side faces inwards: {reach}");
            assert!(e1.dot(e2).abs() < 1e-12);
            volume += area.length() * reach / 3.0;
            closed += area;
        }
        assert_eq!(shapes.len(), 6);
        assert!((volume - 48.0).abs() < 1e-9, "volume {volume} at {degrees}°");
        assert!(closed.length() < 1e-9);
    }
}

/// Seen from above (y up, x right, z towards the viewer) the turn is counter-clockwise: +x goes towards -z.
#[test]
fn boxes_turn_counter_clockwise_about_y() {
    let long_x = boxed(DVec3::ZERO, DVec3::new(10.0, 1.0, 1.0), 30.0);
    let reach = DVec3::new(30f64.to_radians().cos(), 0.0, -(30f64.to_radians().sin())) * 5.0;
    let centers = long_x.iter().map(|shape| match shape.geometry {
        Geometry::Quad { corner, e1, e2 } => corner + 0.5 * (e1 + e2),
        _ => panic!("a box is made of quads"),
    });
    assert!(centers.into_iter().any(|center| center.distance(reach) < 1e-12));
}

fn boxed(center: DVec3, size: DVec3, degrees: f64) -> Vec<Shape> {
    let builder = Scene::builder("box")
        .camera([0.0, 0.0, 9.0], [0.0; 3], 40.0)
        .material("m", Material::diffuse([0.5; 3]));
    builder.boxed(center, size, degrees, "m").build().expect("valid").shapes
}

#[test]
fn darkness_and_excess_are_warned_about() {
    let dark = Scene::from_toml(&ROOM.replace("emission = [15, 15, 15]", "")).expect("valid");
    assert_eq!(dark.warnings(), [SceneWarning::NoLight]);
    assert!(dark.warnings()[0].to_string().contains("black"));

    let unused =
        Scene::from_toml(&ROOM.replace("material = \"lamp\"", "material = \"white\"")).expect("valid");
    assert_eq!(unused.warnings(), [SceneWarning::NoLight]);

    let bright = Scene::from_toml(&ROOM.replace("[0.7, 0.7, 0.7]", "[0.7, 1.2, 0.7]")).expect("valid");
    assert_eq!(bright.warnings(), [SceneWarning::AlbedoAboveOne { material: "white".into(), largest: 1.2 }]);
    assert!(bright.warnings()[0].to_string().contains("material \"white\""));

    let sky = Scene::builder("sky").camera([0.0, 0.0, 1.0], [0.0; 3], 40.0);
    assert_eq!(sky.clone().build().expect("valid").warnings(), [SceneWarning::NoLight]);
    assert_eq!(sky.environment([1.0; 3]).build().expect("valid").warnings(), []);
}

#[test]
fn shapes_smaller_than_ten_spawn_offsets_are_warned_about_once() {
    let build = |radius: f64| {
        let far = Scene::builder("far").camera([1e4, 0.0, 1.0], [1e4, 0.0, 0.0], 40.0).environment([1.0; 3]);
        let ball = |x: f64| [1e4 + x, 0.0, 0.0];
        let balls = far.material("m", Material::diffuse([0.5; 3])).sphere(ball(0.0), radius, "m");
        let balls = balls.named("bead").sphere(ball(2.0), 2.0 * radius, "m").sphere(ball(4.0), 1.0, "m");
        balls.build().expect("valid").warnings()
    };
    assert_eq!(build(0.1), []);
    let warnings = build(0.01);
    let [SceneWarning::BelowResolution { shape, size, others, .. }] = &warnings[..] else {
        panic!("{warnings:?}")
    };
    assert!(shape.contains("bead") && *size == 0.01 && *others == 1, "{warnings:?}");
    let text = warnings[0].to_string();
    assert!(text.contains("\"bead\" (and 1 more) measures only 1.0e-2") && text.contains("origin"), "{text}");
    let alone = build(0.09);
    assert!(alone.len() == 1 && !alone[0].to_string().contains("more"), "{alone:?}");
}
