//! Files that are damaged or made to harm: refused with words, never a panic, and nothing allocated that the file does not hold.

use super::builder::{CUBE, F32, Gltf, Place, U8, glb, load_bytes, meshes, warns};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use proptest::prelude::*;
use qtracer::Scene;
use serde_json::{Value, json};

/// A small file with something of everything.
fn rich() -> Gltf {
    let mut file = Gltf::cube();
    file.add("materials", json!({ "emissiveFactor": [1, 1, 1], "name": "glow" }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let child = file.add("nodes", json!({ "mesh": 0, "rotation": [0, 0, 0, 1] }));
    file.stand(json!({ "children": [child], "scale": [1, -1, 1] }));
    let camera =
        json!({ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5 } });
    let camera = file.add("cameras", camera);
    file.stand(json!({ "camera": camera, "translation": [0, 0, 8] }));
    file.light(json!({ "type": "spot", "spot": {}, "intensity": 5 }), json!({ "translation": [0, 3, 0] }));
    let numbers = file.view(&[1, 2]);
    let values = file.positions(&[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let values = file.json["accessors"][values]["bufferView"].clone();
    file.json["accessors"][0]["sparse"] = json!({
        "count": 2, "indices": { "bufferView": numbers, "componentType": U8 }, "values": { "bufferView": values } });
    file
}

/// Loads or refuses with words.
fn survives(bytes: &[u8]) {
    if let Err(error) = load_bytes(bytes) {
        assert!(error.to_string().len() > 20, "{error}");
    }
}

#[test]
fn files_cut_short_anywhere_are_refused() {
    let whole = rich().glb();
    assert!(load_bytes(&whole).is_ok());
    for length in 0..whole.len() {
        assert!(load_bytes(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
    }
    let text = rich().json.to_string();
    let place = Place::new();
    for length in (0..text.len()).step_by(7) {
        let path = place.write("a.gltf", &text[..length]);
        assert!(Scene::load(path).is_err(), "{length} of {}", text.len());
    }
}

#[test]
fn headers_and_chunks_that_lie_are_refused() {
    let whole = rich().glb();
    let with = |at: usize, word: u32| {
        let mut bytes = whole.clone();
        bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        load_bytes(&bytes).expect_err("refused").to_string()
    };
    for (at, word, words) in [
        (4, 1, "is of version 1 of the .glb format"),
        (8, 0, "promises 0 bytes in its header"),
        (8, 11, "promises 11 bytes in its header"),
        (8, u32::MAX, "promises 4294967295 bytes in its header"),
        (12, u32::MAX, "is cut short"),
        (12, 0, "is cut short"),
        (16, 0, "has no JSON chunk"),
    ] {
        let problem = with(at, word);
        assert!(problem.contains(words), "{problem}");
    }
}

/// Sets the value at a path of keys and numbers, such as `accessors/0/count`.
fn set(file: &mut Gltf, path: &str, value: Value) {
    let (head, last) = path.rsplit_once('/').unwrap();
    let place = file.json.pointer_mut(&format!("/{head}")).unwrap_or_else(|| panic!("{path}"));
    match last.parse::<usize>() {
        Ok(number) => place[number] = value,
        Err(_) => place[last] = value,
    }
}

fn refused(path: &str, value: Value) -> String {
    let mut file = rich();
    file.json["buffers"] = json!([{ "byteLength": file.binary.len() }]);
    set(&mut file, path, value);
    file.problem()
}

#[test]
fn counts_and_offsets_beyond_the_file_are_refused_before_anything_is_allocated() {
    let huge = json!(u64::MAX);
    for (path, value, words) in [
        (
            "accessors/0/count",
            json!(9),
            "has accessors[0], which promises 9 rows of 12 bytes, more than bufferViews[0] holds",
        ),
        ("accessors/0/count", json!(1_000_000_000_000_000_000u64), "more than bufferViews[0] holds"),
        ("accessors/0/count", huge.clone(), "more than bufferViews[0] holds"),
        ("accessors/0/byteOffset", huge.clone(), "more than bufferViews[0] holds"),
        ("accessors/1/count", json!(37), "has accessors[1], which promises 37 rows"),
        ("bufferViews/0/byteLength", huge.clone(), "bufferViews[0], which reaches beyond its buffer"),
        ("bufferViews/0/byteOffset", huge.clone(), "bufferViews[0], which reaches beyond its buffer"),
        ("bufferViews/0/byteStride", json!(4), "has rows of 12 bytes every 4 bytes"),
        ("accessors/0/sparse/count", json!(3), "promises 3 rows of 1 bytes"),
        ("accessors/0/sparse/count", huge.clone(), "promises 18446744073709551615 rows of 1 bytes"),
        ("accessors/0/sparse/indices/byteOffset", json!(1), "promises 2 rows of 1 bytes"),
        ("buffers/0/byteLength", json!(100_000), "buffers[0] promises 100000 bytes and has"),
        ("buffers/0/byteLength", huge, "promises buffers of 18446744073709551615 bytes together"),
        ("accessors/0/type", json!("MAT4"), "holds matrices"),
        ("accessors/0/type", json!("VEC2"), "has POSITION of 2 numbers each, not 3"),
        ("accessors/1/componentType", json!(F32), "has indices that are no whole numbers"),
        ("meshes/0/primitives/0/attributes/POSITION", json!(99), "has an attribute with accessor 99 of 3"),
        (
            "meshes/0/primitives/0/attributes",
            json!({}),
            "is not valid glTF 2.0: \"meshes[0].primitives[0].attributes",
        ),
        ("meshes/0/primitives/0/indices", json!(99), "names something that is not there"),
        ("meshes/0/primitives/0/mode", json!(99), "has a value that is not allowed"),
        ("nodes/0/mesh", json!(99), "nodes[0].mesh\" names something that is not there"),
        ("nodes/1/children", json!([99]), "names something that is not there"),
        ("scenes/0/nodes", json!([99]), "names something that is not there"),
        ("asset/version", json!("1.0"), "is of glTF \"1.0\""),
    ] {
        let problem = refused(path, value);
        assert!(problem.contains(words), "{path}: {problem}");
    }
}

#[test]
fn zeros_that_no_byte_stands_for_are_bounded_too() {
    let mut file = rich();
    file.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    file.json["accessors"][0]["count"] = json!(1_000_000_000);
    assert!(file.problem().contains("promises 1000000000 rows of zeros, more than the file has bytes"));
    let mut file = rich();
    file.binary[12 * 8 + 4 * 36] = 7;
    assert!(file.problem().contains("sparse indices that do not grow or go beyond its rows"));
}

#[test]
fn nodes_that_are_no_tree_are_refused() {
    let mut own_child = Gltf::cube();
    own_child.stand(json!({ "mesh": 0, "children": [0], "name": "ouroboros" }));
    assert!(own_child.problem().contains("nodes[0] \"ouroboros\" is met twice below the scene"));
    // A ladder of 64 diamonds: 2⁶⁴ ways down.
    let mut ladder = Gltf::cube();
    ladder.stand(json!({ "children": [1, 2] }));
    for step in 0..64 {
        let next = json!([2 * step + 3, 2 * step + 4]);
        for _ in 0..2 {
            ladder.add("nodes", json!({ "children": next }));
        }
    }
    for _ in 0..2 {
        ladder.add("nodes", json!({ "mesh": 0 }));
    }
    assert!(ladder.problem().contains("is met twice below the scene"));
    let mut ring = Gltf::cube();
    ring.add("nodes", json!({ "children": [1] }));
    ring.add("nodes", json!({ "children": [0], "mesh": 0 }));
    let (mut rootless, keys) = (ring.clone(), ["scene", "scenes"]);
    keys.iter().for_each(|key| drop(rootless.json.as_object_mut().unwrap().remove(*key)));
    assert!(rootless.problem().contains("has nodes in a cycle"));
    ring.json["scenes"][0]["nodes"] = json!([0]);
    assert!(ring.problem().contains("is met twice"));
    // As deep as wide: no stack runs over.
    let mut deep = Gltf::cube();
    deep.stand(json!({ "children": [1] }));
    for next in 2..20_000 {
        deep.add("nodes", json!({ "children": [next] }));
    }
    deep.add("nodes", json!({ "mesh": 0, "translation": [1, 2, 3] }));
    assert_eq!(deep.scene().shapes.len(), 1);
}

#[test]
fn more_triangles_than_fit_are_refused_before_they_are_laid_out() {
    let mut file = Gltf::new();
    let corners: Vec<u8> =
        (0..400_000u32).flat_map(|i| [i as u8, (i >> 8) as u8, (i >> 16) as u8, 0]).collect();
    let view = file.view(&corners);
    file.json["bufferViews"][view]["byteStride"] = json!(4);
    let positions = file.add(
        "accessors",
        json!({ "bufferView": view, "componentType": U8, "type": "VEC3", "count": 399_999 }),
    );
    // What shines has triangles of its own at each place.
    file.add("materials", json!({ "emissiveFactor": [1, 1, 1] }));
    file.mesh(json!({ "attributes": { "POSITION": positions }, "material": 0 }));
    for _ in 0..252 {
        file.stand(json!({ "mesh": 0 }));
    }
    assert!(file.problem().contains("has more than 33554432 triangles, each instance counted"));
}

#[test]
fn primitives_that_show_nothing_count_too() {
    let mut file = Gltf::cube();
    let primitive = file.json["meshes"][0]["primitives"][0].clone();
    let mut points = primitive.clone();
    points["mode"] = json!(0);
    file.json["meshes"][0]["primitives"] = json!(vec![points; 1025]);
    file.json["meshes"][0]["primitives"][0] = primitive;
    for _ in 0..1024 {
        file.stand(json!({ "mesh": 0 }));
    }
    assert!(file.problem().contains("has more than 1048576 primitives, each instance counted"));
    // One node fewer, and they fit.
    file.json["scenes"][0]["nodes"].as_array_mut().unwrap().pop();
    assert_eq!(file.scene().shapes.len(), 1023);
}

#[test]
fn strips_of_ties_count_before_they_are_walked() {
    let mut file = Gltf::new();
    let positions = file.positions(&CUBE);
    let ties = file.accessor(U8, "SCALAR", 1 << 22, &vec![0; 1 << 22]);
    let strip = json!({ "attributes": { "POSITION": positions }, "indices": ties, "mode": 5 });
    file.add("meshes", json!({ "primitives": vec![strip; 9] }));
    file.stand(json!({ "mesh": 0 }));
    assert!(file.problem().contains("has more than 33554432 triangles; reduce it"));
}

#[test]
fn ten_thousands_of_materials_of_one_name_take_no_minutes() {
    let mut file = Gltf::cube();
    file.json["materials"] = json!(vec![json!({ "name": "wood" }); 20_000]);
    file.stand(json!({ "mesh": 0 }));
    let scene = file.scene();
    assert_eq!(scene.materials[19_999].name, "wood (20000)");
}

#[test]
fn instances_keep_no_more_of_a_name_than_messages_need() {
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0, "name": "ü".repeat(5000) }));
    file.stand(json!({ "mesh": 0, "name": "lid" }));
    let scene = file.scene();
    let name = |shape: usize| scene.shapes[shape].name.as_deref().unwrap();
    assert_eq!((name(0).chars().count(), name(1)), (101, "lid"));
}

#[test]
fn lamps_of_many_triangles_are_not_compared_with_one_another() {
    let mut file = Gltf::cube();
    file.add("materials", json!({ "emissiveFactor": [1, 1, 1] }));
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    for number in 0..20_000 {
        file.stand(json!({ "mesh": 0, "translation": [3 * number, 0, 0] }));
    }
    // 4·10⁸ comparisons took seconds.
    assert!(!warns(&file.scene(), "lies in the surface of"));
}

#[test]
fn descriptions_that_take_memory_out_of_proportion_are_refused() {
    let bomb = |item: &str, count: usize| {
        let text =
            format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{}]}}", vec![item; count].join(","));
        load_bytes(&glb(text.as_bytes(), &[])).expect_err("refused").to_string()
    };
    assert!(bomb("{}", 1 << 20).contains("objects; stay within 1048576"));
    assert!(bomb("[]", 1 << 22).contains("values; stay within 8388608"));
    let deep = format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":{}{}}}",
        "[".repeat(100_000),
        "]".repeat(100_000)
    );
    survives(&glb(deep.as_bytes(), &[]));
}

#[test]
fn numbers_that_are_no_places_are_refused_and_far_ones_are_not() {
    let at = |corner: [f32; 3]| {
        let mut file = Gltf::new();
        let mut corners = CUBE;
        corners[1] = corner;
        let (positions, indices) = (file.positions(&corners), file.indices(&super::builder::CUBE_SIDES));
        file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
        file.stand(json!({ "mesh": 0 }));
        file
    };
    let problem = at([0.0, f32::NAN, 0.0]).problem();
    assert!(
        problem.contains("meshes[0], primitives[0] has a corner (number") && problem.contains("nan"),
        "{problem}"
    );
    assert!(at([f32::INFINITY, 0.0, 0.0]).problem().contains("that is infinite or not a number"));
    assert!(at([2e9, 0.0, 0.0]).problem().contains("beyond ±1e9; scale it down"));
    let mut far = Gltf::cube();
    far.stand(json!({ "mesh": 0, "translation": [1e6, -1e6, 1e6] }));
    let scene = far.scene();
    assert_eq!(meshes(&scene)[0].bounds()[0].to_array(), [999_999.0, -1_000_001.0, 999_999.0]);
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0, "translation": [1e39, 0, 0] }));
    assert!(file.problem().contains("stands infinitely far away"));
    let mut file = Gltf::cube();
    file.stand(json!({ "mesh": 0, "rotation": [0, 0, 0, 0] }));
    assert!(warns(&file.scene(), "has a rotation of all zeros"));
}

#[test]
fn buffers_come_from_the_models_folder_and_nowhere_else() {
    let place = Place::new();
    let mut file = rich();
    place.write("in/side/my buffer.bin", &file.binary);
    place.write("outside.bin", &file.binary);
    place.write("in/short.bin", &file.binary[..9]);
    let outside = place.path().join("outside.bin").display().to_string();
    let mut load = |uri: &str| {
        file.json["buffers"] = json!([{ "byteLength": file.binary.len(), "uri": uri }]);
        Scene::load(place.write("in/a.gltf", file.json.to_string())).map_err(|error| error.to_string())
    };
    let inside = load("side/my%20buffer.bin").unwrap();
    assert!(load("./side/../side/my buffer.bin").is_ok());
    let data = |kind: &str, text: &str| format!("data:{kind},{text}");
    let binary = rich().binary;
    let encoded = load(&data("application/octet-stream;base64", &STANDARD.encode(&binary))).unwrap();
    assert_eq!(encoded.shapes, inside.shapes);
    for (uri, words) in [
        ("../outside.bin", "file \"../outside.bin\" lies outside the scene's folder"),
        ("side/%2e%2e/%2e%2e/outside.bin", "lies outside the scene's folder"),
        (&outside, "lies outside the scene's folder"),
        ("http://example.com/a.bin", "qtracer reads nothing from networks"),
        ("file:///etc/hostname", "qtracer reads nothing from networks or by full names"),
        ("C:/a.bin", "qtracer reads nothing from networks or by full names"),
        ("nowhere.bin", "buffers[0] file \"nowhere.bin\" no such file"),
        ("side", "is not a regular file"),
        ("short.bin", "bytes and has 9; it is cut short"),
        ("%ff.bin", "which is no UTF-8"),
        (&data("x;base64", "????"), "is not base64"),
        (&data("x;base64", "AAAA"), "bytes and has 3"),
        ("data:nothing", "without a comma"),
    ] {
        let problem = load(uri).expect_err(uri);
        assert!(problem.contains(words), "{uri}: {problem}");
    }
    file.json["buffers"] = json!([{ "byteLength": 4 }]);
    let path = place.write("in/a.gltf", file.json.to_string());
    assert!(Scene::load(path).unwrap_err().to_string().contains("has neither a uri nor a binary chunk"));
}

/// Every place of a value in a file.
fn leaves(value: &Value, path: String, found: &mut Vec<String>) {
    match value {
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, item)| leaves(item, format!("{path}/{i}"), found));
        }
        Value::Object(entries) => {
            entries.iter().for_each(|(key, item)| leaves(item, format!("{path}/{key}"), found));
        }
        _ => (),
    }
    if !path.is_empty() {
        found.push(path);
    }
}

const ODD: &[&str] = &[
    "null",
    "-1",
    "0",
    "1",
    "2",
    "255",
    "1e39",
    "-1e300",
    "0.5",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "[]",
    "{}",
    "\"\"",
    "true",
    "[0]",
    "[[]]",
    "[1e38,-1e38,1e38]",
    "\"data:,x\"",
    "5120",
    "5126",
];

/// Where bytes change, and to what.
fn flips() -> impl Strategy<Value = Vec<(prop::sample::Index, u8)>> {
    prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
}

fn survives_flips(flips: Vec<(prop::sample::Index, u8)>) {
    let mut bytes = rich().glb();
    for (at, value) in flips {
        let at = at.index(bytes.len());
        bytes[at] = value;
    }
    survives(&bytes);
}

/// Where values change, and to which odd one.
fn changes() -> impl Strategy<Value = Vec<(prop::sample::Index, usize)>> {
    prop::collection::vec((any::<prop::sample::Index>(), 0..ODD.len()), 1..4)
}

fn survives_changes(changes: Vec<(prop::sample::Index, usize)>) {
    let mut file = rich();
    file.json["buffers"] = json!([{ "byteLength": file.binary.len() }]);
    for (at, odd) in changes {
        let mut places = Vec::new();
        leaves(&file.json, String::new(), &mut places);
        let odd: Value = serde_json::from_str(ODD[odd]).unwrap();
        *file.json.pointer_mut(&places[at.index(places.len())]).unwrap() = odd;
    }
    survives(&file.glb());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_flipped_bytes_panic(flips in flips()) {
        survives_flips(flips);
    }

    #[test]
    fn no_odd_value_panics(changes in changes()) {
        survives_changes(changes);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60_000, failure_persistence: None, ..Default::default() })]

    #[test]
    #[ignore = "long: minutes of damaged models"]
    fn no_flipped_bytes_panic_for_long(flips in flips()) {
        survives_flips(flips);
    }

    #[test]
    #[ignore = "long: minutes of damaged models"]
    fn no_odd_value_panics_for_long(changes in changes()) {
        survives_changes(changes);
    }
}

/// That nothing has an area is said only where nothing else is wrong.
#[test]
fn damage_is_named_before_a_missing_area() {
    let ply = |face: &str| {
        let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                      element face 1\nproperty list uchar int vertex_indices\nend_header\n";
        format!("{header}0 0 0\n1 0 0\n0 1 0\n{face}\n")
    };
    for (name, text, problem) in [
        ("nan.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n".to_owned(), "not a number"),
        ("far.obj", "v 0 0 0\nv 1 0 0\nv 2e20 1 0\nf 1 2 3\n".to_owned(), "beyond ±1e9"),
        ("corner.ply", ply("3 0 1 7"), "with corner 7 of 3"),
        ("line.ply", ply("3 0 1 1"), "has no area"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let error = Scene::load(path).unwrap_err().to_string();
        assert!(error.contains(problem), "{name}: {error}");
    }
}
