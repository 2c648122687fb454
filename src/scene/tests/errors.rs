//! Every mistake gets an error that names the object and the remedy.

use super::ROOM;
use crate::scene::{Material, Scene, SceneError, check_image_size};

/// The message after replacing `from`, which must be there, by `to` in the valid room.
#[track_caller]
fn broken(from: &str, to: &str) -> String {
    assert!(ROOM.contains(from), "{from} is not in the room");
    Scene::from_toml(&ROOM.replacen(from, to, 1)).expect_err("this is a mistake").to_string()
}

/// The message names what it should, in this order.
#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    let mut rest = message;
    for part in parts {
        let Some(at) = rest.find(part) else { panic!("{message:?} does not say {part:?} there") };
        rest = &rest[at + part.len()..];
    }
}

#[test]
fn numbers_must_be_finite_as_f32() {
    assert_says(&broken("radius = 0.5", "radius = nan"), &["line 38", r#"shapes[1] "lamp""#, "not a number"]);
    assert_says(&broken("radius = 0.5", "radius = -inf"), &["shapes[1]", "infinite"]);
    assert_says(&broken("radius = 0.5", "radius = 1e39"), &["shapes[1]", "too large", "scale"]);
    assert_says(&broken("radius = 0.5", "radius = 1e999"), &["shapes[1]", "infinite"]);
    assert_says(&broken("radius = 0.5", "radius = 1e-60"), &["shapes[1]", "below 1e-12", "scale"]);
    assert_says(&broken("origin = [0, 1, 4]", "origin = [0, nan, 4]"), &["camera: origin", "finite"]);
    assert_says(&broken("corner = [-1, 0, -1]", "corner = [inf, 0, -1]"), &["shapes[0]: corner"]);
    assert_says(
        &broken("[0, 3, 0]\nradius = 0.5", "[3e38, 3, 0]\nradius = 1e38"),
        &["shapes[1]", "center", "beyond ±1e9", "scale"],
    );
    assert_says(&broken("radius = 0.5", "radius = 1e10"), &["shapes[1]", "above 1e9", "scale"]);
    assert_says(&broken("level = 0.5", "level = nan"), &[r#"material "polished": level"#]);
    assert_says(&broken("fov_y_deg = 40", "fov_y_deg = nan"), &["camera: fov_y_deg"]);
}

#[test]
fn spheres_have_positive_radii() {
    assert_says(&broken("radius = 0.5", "radius = 0"), &[r#"shapes[1] "lamp": radius is 0"#, "positive"]);
    assert_says(&broken("radius = 0.5", "radius = -2"), &["radius -2 is negative", "inward = true"]);
}

#[test]
fn quads_have_area_and_boxes_volume() {
    assert_says(
        &broken("e1 = [0, 0, 2]", "e1 = [4, 0, 0]"),
        &["shapes[0]: edges [4, 0, 0] and [2, 0, 0] are parallel"],
    );
    assert_says(&broken("e1 = [0, 0, 2]", "e1 = [0, 0, 0]"), &["shapes[0]: edge e1 is zero"]);
    assert_says(&broken("size = [1, 2, 3]", "size = [1, 0, 3]"), &["shapes[2]: size [1, 0, 3]", "quad"]);
}

#[test]
fn cameras_see_something() {
    assert_says(
        &broken("origin = [0, 1, 4]", "origin = [0, 0, 0]"),
        &["line 3: camera: origin and target", "move"],
    );
    assert_says(
        &broken("origin = [0, 1, 4]", "up = [0, 2, 8]\norigin = [0, 1, 4]"),
        &["camera: up is parallel"],
    );
    assert_says(&broken("origin = [0, 1, 4]", "up = [0, 0, 0]\norigin = [0, 1, 4]"), &["camera: up is zero"]);
    for fov in ["0", "-40", "180", "400"] {
        assert_says(
            &broken("fov_y_deg = 40", &format!("fov_y_deg = {fov}")),
            &["camera: fov_y_deg", "between 0 and 180"],
        );
    }
    assert_says(&broken("fov_y_deg = 40", ""), &["camera: fov_y_deg is missing"]);
    assert_says(
        &broken("width = 320", "width = 0"),
        &["camera: image size 0 × 240 has no pixels", "1 or more"],
    );
    assert_says(&broken("width = 320", "width = 65537"), &["camera", "65536"]);
    assert_says(
        &broken("width = 320", "width = 1.5"),
        &["line 6", "camera: width must be a whole number", "not 1.5"],
    );
}

#[test]
fn image_sizes_are_bounded() {
    assert_eq!(check_image_size(640, 480), Ok((640, 480)));
    assert_eq!(check_image_size(16_384, 16_384), Ok((16_384, 16_384)));
    let message = |width, height| check_image_size(width, height).expect_err("refused").to_string();
    assert_says(&message(0, 480), &["0 × 480", "no pixels"]);
    assert_says(&message(32_768, 16_384), &["32768 × 16384", "91268055040 bytes", "170 a pixel"]);
    assert_says(&message(1_000_000, 1_000_000), &["would need 170000000000000 bytes"]);
    assert_says(&message(1_000_000, 2), &["too large", "65536"]);
    assert_says(&message(u64::MAX, u64::MAX), &["too large", "65536"]);
}

#[test]
fn materials_are_physical() {
    assert_says(
        &broken("color = [0.7, 0.7, 0.7]", "color = [0.7, -0.1, 0.7]"),
        &[r#"material "white": color [0.7, -0.1, 0.7] is negative"#],
    );
    assert_says(
        &broken("emission = [15, 15, 15]", "emission = [15, 15, -1]"),
        &[r#"material "lamp": emission"#, "negative"],
    );
    assert_says(&broken("level = 0.5", "level = 1.5"), &[r#"material "polished": level 1.5"#, "0 to 1"]);
    assert_says(&broken("exponent = 20", "exponent = 1e7"), &[r#"material "shiny": exponent"#, "1e6"]);
    assert_says(&broken("exponent = 20", "exponent = -1"), &["exponent -1"]);
    assert_says(&broken("ior = 1.5", "ior = 0"), &[r#"material "glass": ior 0 must be positive"#]);
    assert_says(
        &broken("ior = 1.5", "ior = 0.8"),
        &[r#"material "glass": ior 0.8 is below 1; swap interior and exterior"#],
    );
    assert_says(&broken("ior = 1.5", "ior = 11"), &[r#"material "glass": ior 11 is above 10"#]);
    let dark = ROOM.replacen("[render]", "[environment]\nradiance = [0, -1, 0]\n[render]", 1);
    assert_says(
        &Scene::from_toml(&dark).expect_err("negative").to_string(),
        &["environment: radiance", "negative"],
    );
}

#[test]
fn render_defaults_are_in_range() {
    assert_says(&broken("spp = 16", "spp = 0"), &["render: spp is 0", "at least 1"]);
    assert_says(&broken("spp = 16", "max_bounces = 0"), &["render: max_bounces 0", "1 to 64"]);
    assert_says(&broken("spp = 16", "max_bounces = 65"), &["render: max_bounces 65"]);
    assert_says(&broken("spp = 16", "spp = -1"), &["line 9", "render: spp must be a whole number", "not -1"]);
}

#[test]
fn misspellings_are_corrected() {
    assert_says(
        &broken("material = \"white\"", "material = \"whit\""),
        &[r#"line 33: shapes[0]: unknown material "whit"; did you mean "white"?"#],
    );
    assert_says(
        &broken("color = [0.7", "colour = [0.7"),
        &[r#"line 12: material "white": unknown key "colour"; did you mean "color"?"#],
    );
    assert_says(
        &broken("type = \"glossy\"", "type = \"glosy\""),
        &[r#"material "shiny": unknown type "glosy"; did you mean "glossy"?"#],
    );
    assert_says(
        &broken("type = \"dielectric\"", "type = \"glass\""),
        &[r#"unknown type "glass"; use "dielectric""#],
    );
    assert_says(
        &broken("type = \"sphere\"", "type = \"spheer\""),
        &[r#"shapes[1] "lamp": unknown type "spheer"; did you mean "sphere"?"#],
    );
    assert_says(&broken("type = \"sphere\"", "type = \"xyzzy\""), &[r#"use one of "sphere", "quad", "box""#]);
    assert_says(
        &broken("[render]", "[rendr]"),
        &[r#"line 8: scene: unknown key "rendr"; did you mean "render"?"#],
    );
    assert_says(&broken("fov_y_deg", "fov"), &[r#"camera: unknown key "fov"; did you mean "fov_y_deg"?"#]);
}

#[test]
fn rough_materials_are_in_range() {
    let rough = |lines: &str| broken("type = \"dielectric\"\nior = 1.5", lines);
    let metal = |key: &str| rough(&format!("type = \"metal\"\ncolor = [1, 1, 1]\n{key}"));
    assert_says(
        &metal("roughness = 1.5"),
        &["line 16: material \"glass\": roughness 1.5 is not within 0 to 1"],
    );
    assert_says(&metal("roughness = -0.1"), &["roughness -0.1 is not within 0 to 1", "0 is smooth"]);
    assert_says(&metal("roughness = nan"), &["roughness is not a number"]);
    assert_says(&metal("metallic = 1"), &["unknown key \"metallic\""]);
    assert_says(&metal("# nothing"), &["roughness is missing; give a number"]);
    let coated = |keys: &str| rough(&format!("type = \"metallic-roughness\"\ncolor = [1, 1, 1]\n{keys}"));
    assert_says(&coated("metallic = 2\nroughness = 0.5"), &["metallic 2 is not within 0 to 1", "1 is metal"]);
    assert_says(&coated("metallic = 0\nroughness = 2"), &["roughness 2 is not within 0 to 1"]);
    assert_says(&coated("roughness = 0.5"), &["metallic is missing"]);
    let glass = |keys: &str| rough(&format!("type = \"rough-dielectric\"\n{keys}"));
    assert_says(&glass("ior = 0.5\nroughness = 0.5"), &["ior 0.5 is below 1; swap interior and exterior"]);
    assert_says(&glass("ior = 1.5\nroughness = inf"), &["roughness is infinite"]);
    assert_says(&glass("ior = 1.5\nroughness = 0.5\ncolor = [1, 1, 1]"), &["unknown key \"color\""]);
    assert_says(&rough("type = \"conductor\""), &["unknown type \"conductor\"; use \"metal\""]);
    assert_says(&rough("type = \"principled\""), &["use \"metallic-roughness\""]);
}

#[test]
fn wrong_kinds_of_values_are_named() {
    assert_says(
        &broken("name = \"room\"", "name = 3"),
        &["line 1: scene: name must be a text in quotes, not 3"],
    );
    assert_says(&broken("name = \"room\"", ""), &["scene: name is missing"]);
    assert_says(
        &broken("origin = [0, 1, 4]", "origin = [0, 1]"),
        &["camera: origin must be a list of three numbers", "not a list of 2"],
    );
    assert_says(&broken("radius = 0.5", "radius = 2020-01-01"), &["radius must be a number, not a date"]);
    assert_says(&broken("radius = 0.5", "radius = 0.5\ninward = 1"), &["inward must be true or false"]);
    let message = |json: &str| Scene::from_json(json).expect_err("wrong").to_string();
    assert_says(&message("[1]"), &["scene: must be a table of keys, not a list of 1"]);
    assert_says(&message(r#"{"name": "x"}"#), &["camera: is missing"]);
    assert_says(&message(r#"{"name": "x", "materials": []}"#), &["materials: must be tables"]);
}

#[test]
fn repeated_names_are_refused() {
    assert_says(
        &broken("[materials.glass]", "[materials.white]"),
        &["line 13: not valid TOML: duplicate key"],
    );
    let twice = "{\n \"name\": \"a\",\n \"name\": \"b\"\n}";
    assert_says(
        &Scene::from_json(twice).expect_err("twice").to_string(),
        &["line 3", "key \"name\" is given twice"],
    );
    let built = Scene::builder("x")
        .camera([0.0, 0.0, 1.0], [0.0; 3], 40.0)
        .material("white", Material::diffuse([0.5; 3]))
        .material("white", Material::diffuse([0.6; 3]))
        .build();
    assert_says(&built.expect_err("twice").to_string(), &[r#"material "white": is defined twice"#]);
}

#[test]
fn malformed_text_names_the_line() {
    assert_says(&broken("fov_y_deg = 40", "fov_y_deg = "), &["line 5: not valid TOML"]);
    assert_says(
        &Scene::from_json("{\n\"name\": }").expect_err("bad").to_string(),
        &["line 2: not valid JSON"],
    );
    assert_says(
        &Scene::from_json("{\"name\": 1e999}").expect_err("bad").to_string(),
        &["line 1: not valid JSON", "range"],
    );
    assert_says(&Scene::from_toml(" \n").expect_err("empty").to_string(), &["scene: is empty"]);
}

#[test]
fn built_scenes_keep_the_same_rules() {
    let builder = || Scene::builder("x").material("white", Material::diffuse([0.5; 3]));
    assert_says(&builder().build().expect_err("no camera").to_string(), &["camera: is missing"]);
    let builder = || builder().camera([0.0, 0.0, 1.0], [0.0; 3], 40.0);
    let message = |result: Result<Scene, SceneError>| result.expect_err("refused").to_string();
    assert_says(
        &message(builder().sphere([0.0; 3], 0.0, "white").named("dot").build()),
        &[r#"shapes[0] "dot": radius is 0"#],
    );
    assert_says(
        &message(builder().boxed([0.0; 3], [1.0, f64::NAN, 1.0], 0.0, "white").build()),
        &["shapes[0]: size"],
    );
    assert_says(&message(builder().sphere([0.0; 3], 1.0, "wite").build()), &["did you mean \"white\"?"]);
    assert_says(&message(builder().material("", Material::diffuse([0.5; 3])).build()), &["has no name"]);
    assert_says(&message(builder().size(0, 9).build()), &["camera: image size 0 × 9"]);
    assert_says(&message(builder().environment([-1.0, 0.0, 0.0]).build()), &["environment"]);
}
