//! Numbers in buffers: every type of component, sparse rows, strides; and how corners make triangles.

use super::builder::{CUBE, CUBE_SIDES, F32, Gltf, U8, U16, U32, meshes, warns};
use glam::Vec3;
use serde_json::{Value, json};

const I8: u32 = 5120;
const I16: u32 = 5122;

/// The corners of the first triangle of a file with one mesh, made of that accessor.
fn first_triangle(mut file: Gltf, positions: usize) -> [Vec3; 3] {
    file.mesh(json!({ "attributes": { "POSITION": positions } }));
    file.stand(json!({ "mesh": 0 }));
    let scene = file.scene();
    meshes(&scene)[0].triangles().next().unwrap()
}

fn little_endian(component: u32, numbers: &[f64]) -> Vec<u8> {
    let bytes = |x: f64| match component {
        I8 => (x as i8).to_le_bytes().to_vec(),
        U8 => (x as u8).to_le_bytes().to_vec(),
        I16 => (x as i16).to_le_bytes().to_vec(),
        U16 => (x as u16).to_le_bytes().to_vec(),
        U32 => (x as u32).to_le_bytes().to_vec(),
        _ => (x as f32).to_le_bytes().to_vec(),
    };
    numbers.iter().flat_map(|&x| bytes(x)).collect()
}

#[test]
fn every_component_type_is_read_and_divided_where_it_is_normalised() {
    let corners = [[0.0, 0.0, 1.0], [100.0, 2.0, 3.0], [4.0, 120.0, 5.0]];
    let greatest = [(I8, 127.0), (U8, 255.0), (I16, 32767.0), (U16, 65535.0)];
    for (component, divisor) in greatest.into_iter().chain([(F32, 1.0)]) {
        for normalized in [false, true] {
            let mut file = Gltf::new();
            let bytes = little_endian(component, &corners.concat());
            let positions = file.accessor(component, "VEC3", 3, &bytes);
            file.json["accessors"][0]["normalized"] = json!(normalized);
            let scale = if normalized { divisor } else { 1.0 };
            let expected = corners.map(|corner| (glam::DVec3::from_array(corner) / scale).as_vec3());
            assert_eq!(first_triangle(file, positions), expected, "{component} normalised {normalized}");
        }
    }
    // The least number of a signed type is as far below 0 as the greatest is above.
    let mut file = Gltf::new();
    let positions = file.accessor(
        I8,
        "VEC3",
        3,
        &little_endian(I8, &[-128.0, 0.0, 0.0, -127.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
    );
    file.json["accessors"][0]["normalized"] = json!(true);
    let [a, b, _] = first_triangle(file, positions);
    assert_eq!((a.x, b.x), (-1.0, -1.0));
}

#[test]
fn indices_of_every_type_and_none_give_the_same_triangles() {
    let mut found = Vec::new();
    for component in [Some(U8), Some(U16), Some(U32), None] {
        let mut file = Gltf::new();
        let indices = CUBE_SIDES.concat();
        let primitive = match component {
            Some(component) => {
                let numbers: Vec<f64> = indices.iter().map(|&i| f64::from(i)).collect();
                let positions = file.positions(&CUBE);
                let indices =
                    file.accessor(component, "SCALAR", indices.len(), &little_endian(component, &numbers));
                json!({ "attributes": { "POSITION": positions }, "indices": indices })
            }
            None => {
                let corners: Vec<[f32; 3]> = indices.iter().map(|&i| CUBE[i as usize]).collect();
                json!({ "attributes": { "POSITION": file.positions(&corners) } })
            }
        };
        file.mesh(primitive);
        file.stand(json!({ "mesh": 0 }));
        let scene = file.scene();
        found.push(meshes(&scene)[0].triangles().collect::<Vec<_>>());
    }
    assert_eq!(found[0].len(), 12);
    assert!(found.iter().all(|triangles| *triangles == found[0]));
}

#[test]
fn rows_may_lie_apart_and_begin_anywhere() {
    let mut file = Gltf::new();
    // Two rows of four numbers each: a position, and something else between.
    let mut numbers = vec![77.0f32; 3];
    for corner in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        numbers.extend(corner);
        numbers.push(55.0);
    }
    let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    let view = file.view(&bytes);
    file.json["bufferViews"][view]["byteStride"] = json!(16);
    let positions = file.add(
        "accessors",
        json!({ "bufferView": view, "byteOffset": 12, "componentType": F32, "type": "VEC3", "count": 3 }),
    );
    assert_eq!(first_triangle(file, positions), [Vec3::ZERO, Vec3::X, Vec3::Y]);
}

#[test]
fn sparse_rows_replace_those_of_the_base_or_zeros() {
    for based in [true, false] {
        let mut file = Gltf::new();
        let base = file.positions(&[[9.0, 0.0, 0.0], [8.0, 0.0, 0.0], [7.0, 0.0, 0.0]]);
        let numbers = file.view(&[1, 2]);
        let values: Vec<u8> =
            [0.0f32, 1.0, 0.0, 0.0, 0.0, 1.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let values = file.view(&values);
        let mut accessor = json!({ "componentType": F32, "type": "VEC3", "count": 3, "sparse": {
            "count": 2, "indices": { "bufferView": numbers, "componentType": U8 }, "values": { "bufferView": values } } });
        if based {
            accessor["bufferView"] = file.json["accessors"][base]["bufferView"].clone();
        }
        let positions = file.add("accessors", accessor);
        let first = if based { Vec3::X * 9.0 } else { Vec3::ZERO };
        assert_eq!(first_triangle(file, positions), [first, Vec3::Y, Vec3::Z]);
    }
}

/// The triangles of a mesh of these corners in that mode.
fn in_mode(mode: u32, corners: &[[f32; 3]], extra: Value) -> Vec<[Vec3; 3]> {
    let mut file = Gltf::new();
    let positions = file.positions(corners);
    let mut primitive = json!({ "attributes": { "POSITION": positions }, "mode": mode });
    if let Some(indices) = extra.as_array() {
        let bytes: Vec<u8> = indices.iter().map(|i| i.as_u64().unwrap() as u8).collect();
        primitive["indices"] = json!(file.accessor(U8, "SCALAR", bytes.len(), &bytes));
    }
    file.mesh(primitive);
    file.stand(json!({ "mesh": 0 }));
    let scene = file.scene();
    meshes(&scene)[0].triangles().collect()
}

const ROW: [[f32; 3]; 5] =
    [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [2.0, 1.0, 0.0]];

#[test]
fn strips_and_fans_face_one_way() {
    let strip = in_mode(5, &ROW, json!(null));
    let around = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.5, 0.0]];
    let fan = in_mode(6, &around, json!(null));
    for triangles in [&strip, &fan] {
        assert_eq!(triangles.len(), 3);
        let areas = triangles.iter().map(|[a, b, c]| (b - a).cross(c - a).z * 0.5);
        assert!(areas.clone().all(|area| area > 0.0), "{triangles:?}");
    }
    let area =
        |triangles: &[[Vec3; 3]]| triangles.iter().map(|[a, b, c]| (b - a).cross(c - a).z * 0.5).sum::<f32>();
    assert_eq!((area(&strip), area(&fan)), (1.5, 1.5));
}

#[test]
fn corners_that_tie_strips_together_are_no_repair() {
    // 0 1 2 | 2 3 3: one triangle, two ties, another turn.
    let triangles = in_mode(5, &ROW, json!([0, 1, 2, 2, 3, 3, 4]));
    assert_eq!(triangles.len(), 1);
    let mut file = Gltf::new();
    let positions = file.positions(&ROW);
    let indices = file.accessor(U8, "SCALAR", 6, &[0, 1, 2, 2, 2, 3]);
    file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices, "mode": 5 }));
    file.stand(json!({ "mesh": 0 }));
    assert!(!warns(&file.scene(), "without area"));
}

#[test]
fn points_and_lines_are_left_out_and_told_of() {
    let mut file = Gltf::cube();
    let positions = file.positions(&ROW);
    let parts = (0..4).map(|mode| json!({ "attributes": { "POSITION": positions }, "mode": mode }));
    let parts: Vec<Value> = parts.collect();
    file.add("meshes", json!({ "name": "wire", "primitives": parts }));
    file.stand(json!({ "mesh": 0 }));
    file.stand(json!({ "mesh": 1 }));
    let scene = file.scene();
    assert_eq!(scene.shapes.len(), 1);
    assert!(warns(&scene, "meshes[1] \"wire\", primitives[0] and 3 more: is of points or lines"));
    // A list whose last triangle lacks a corner.
    let mut file = Gltf::new();
    let positions = file.positions(&ROW);
    file.mesh(json!({ "attributes": { "POSITION": positions } }));
    file.stand(json!({ "mesh": 0 }));
    assert!(warns(&file.scene(), "has corners left over"));
}

#[test]
fn primitives_that_share_a_list_of_corners_take_what_they_use() {
    let mut file = Gltf::new();
    let mut corners = vec![[f32::NAN; 3]; 1000];
    (corners[500], corners[501], corners[999]) = ([0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let positions = file.positions(&corners);
    let indices = file.indices(&[[500, 501, 999]]);
    file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    file.stand(json!({ "mesh": 0 }));
    let scene = file.scene();
    assert_eq!(meshes(&scene)[0].triangles().collect::<Vec<_>>(), [[Vec3::ZERO, Vec3::X, Vec3::Y]]);
}
