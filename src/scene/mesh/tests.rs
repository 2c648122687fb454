//! Meshes: what files of every form give, what is repaired, what is refused; and that no bytes make a reader panic.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::file::{MeshFormat, parse};
use super::{Mesh, MeshData, Placement, Repairs};
use crate::scene::{Material, Scene, SceneBuilder};

/// A square pyramid: the base is a face of four corners.
const PLY: &str = "ply
format ascii 1.0
comment a pyramid
element vertex 5
property float x
property float y
property double z
property float nx
property float ny
property float nz
property uchar red
element face 5
property list uchar int vertex_indices
end_header
-1 0 -1 0 -1 0 255
1 0 -1 0 -1 0 255
1 0 1 0 -1 0 255
-1 0 1 0 -1 0 255
0 2 0 0 1 0 255
4 0 1 2 3
3 0 4 1
3 1 4 2
3 2 4 3
3 3 4 0
";

const OBJ: &str = "# the same pyramid
mtllib nowhere.mtl
o pyramid
v -1 0 -1
v 1 0 -1
v 1 0 1
v -1 0 1
v 0 2 0
usemtl stone
f 1 2 3 4
f 1 5 2
f 2 5 3
f -3 -1 -2
f 4/1 5/2 1/3
";

fn binary_ply(big_endian: bool) -> Vec<u8> {
    let (header, body) = PLY.split_once("end_header\n").unwrap();
    let order = if big_endian { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = format!("{}end_header\n", header.replace("ascii", order)).into_bytes();
    let mut put = |mut word: Vec<u8>| {
        if big_endian {
            word.reverse();
        }
        bytes.extend(word);
    };
    for (number, line) in body.lines().enumerate() {
        let values: Vec<f64> = line.split(' ').map(|value| value.parse().unwrap()).collect();
        for (i, &value) in values.iter().enumerate() {
            match (number < 5, i) {
                (true, 2) => put(value.to_le_bytes().to_vec()),
                (true, 0..6) => put((value as f32).to_le_bytes().to_vec()),
                (true, _) | (false, 0) => put(vec![value as u8]),
                (false, _) => put((value as i32).to_le_bytes().to_vec()),
            }
        }
    }
    bytes
}

fn read(format: MeshFormat, bytes: &[u8]) -> Result<MeshData, String> {
    parse(format, bytes, bytes.len() as u64)
}

/// All forms of the same mesh.
fn forms() -> [(MeshFormat, Vec<u8>); 4] {
    [
        (MeshFormat::Ply, PLY.as_bytes().to_vec()),
        (MeshFormat::Ply, binary_ply(false)),
        (MeshFormat::Ply, binary_ply(true)),
        (MeshFormat::Obj, OBJ.as_bytes().to_vec()),
    ]
}

#[test]
fn every_form_of_a_file_gives_the_same_mesh() {
    let corners = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [0.0, 2.0, 0.0]];
    let corners = corners.map(DVec3::from_array);
    let faces = [[0, 1, 2], [0, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]];
    for (number, (format, bytes)) in forms().into_iter().enumerate() {
        let data = read(format, &bytes).unwrap();
        let at = |triangles: &[[u32; 3]], positions: &[DVec3]| -> Vec<[DVec3; 3]> {
            triangles.iter().map(|triangle| triangle.map(|corner| positions[corner as usize])).collect()
        };
        assert_eq!(at(&data.triangles, &data.positions), at(&faces, &corners), "form {number}");
        let mesh = Mesh::new(&data).unwrap();
        // Those of the base point away from the sides, at two corners of each.
        let (normals, opposite) = if number < 3 { (6, 8) } else { (0, 0) };
        assert_eq!((mesh.len(), mesh.repairs()), (6, Repairs { normals: opposite, ..Default::default() }));
        assert_eq!(mesh.normals().count(), normals, "form {number}");
    }
}

#[test]
fn a_byte_order_mark_hides_no_line() {
    let corners = &OBJ[OBJ.find("v -1").unwrap()..];
    let marked = read(MeshFormat::Obj, format!("\u{feff}{corners}").as_bytes()).unwrap();
    assert_eq!(marked, read(MeshFormat::Obj, corners.as_bytes()).unwrap());
    assert_eq!(marked.positions[0], DVec3::new(-1.0, 0.0, -1.0));
}

#[test]
fn comments_behind_and_lines_that_go_on_change_nothing() {
    let plain = read(MeshFormat::Obj, OBJ.as_bytes()).unwrap();
    let odd = OBJ.replace("f 1 2 3 4", "f 1 2 \\\n3 4 # the base").replace("f 1 5 2", "f 1 \\\r\n5 2#side");
    assert_eq!(read(MeshFormat::Obj, odd.as_bytes()), Ok(plain));
}

#[test]
fn vertices_without_a_coordinate_are_refused() {
    for axis in ["x", "y", "z"] {
        let text = PLY.replace(&format!(" {axis}\n"), " w\n");
        let problem = read(MeshFormat::Ply, text.as_bytes()).unwrap_err();
        assert!(problem.contains("without x, y and z"), "{problem}");
    }
}

#[test]
fn a_mesh_is_scaled_then_turned_then_moved() {
    let data = MeshData {
        positions: vec![DVec3::X, DVec3::Y, DVec3::Z],
        normals: vec![DVec3::X; 3],
        ..Default::default()
    };
    let translate = DVec3::new(10.0, 0.0, 0.0);
    let placed = data.clone().placed(&Placement { scale: 2.0, rotate_y_deg: 90.0, translate });
    // A quarter turn counterclockwise from above takes x to −z and z to x, as it turns a box.
    let expected = [DVec3::new(10.0, 0.0, -2.0), DVec3::new(10.0, 2.0, 0.0), DVec3::new(12.0, 0.0, 0.0)];
    assert_eq!(placed.positions, expected);
    // Of any length: a mesh makes them 1.
    assert_eq!(placed.normals.iter().map(|n| n.normalize()).collect::<Vec<_>>(), [DVec3::NEG_Z; 3]);
    assert_eq!(data.clone().placed(&Placement::default()), data);
}

fn triangle(corners: [[f64; 3]; 3]) -> MeshData {
    MeshData {
        positions: corners.map(DVec3::from_array).to_vec(),
        triangles: vec![[0, 1, 2]],
        ..Default::default()
    }
}

#[test]
fn triangles_without_area_and_repeated_ones_are_left_out_with_one_warning() {
    let mut data = triangle([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    data.positions.extend([DVec3::new(0.5, 0.0, 0.0), DVec3::new(-0.0, 0.0, 0.0)]);
    // The same turned and turned over, by another number; a point; a line.
    data.triangles.extend([[1, 2, 0], [4, 2, 1], [0, 0, 1], [0, 3, 1]]);
    let scene = one_mesh(data).build().unwrap();
    let warnings: Vec<String> = scene.warnings().iter().map(|warning| warning.to_string()).collect();
    let expected = "shapes[0]: left out 2 triangles without area and 2 that repeat another; clean the mesh to be rid of this";
    assert_eq!(warnings, [expected]);
}

fn one_mesh(data: MeshData) -> SceneBuilder {
    Scene::builder("mesh")
        .camera([0.0, 0.0, 4.0], [0.0; 3], 45.0)
        .environment([1.0; 3])
        .material("m", Material::diffuse([0.5; 3]))
        .mesh(data, "m")
}

#[test]
fn what_is_no_mesh_says_why() {
    let right = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let with = |change: &dyn Fn(&mut MeshData)| {
        let mut data = triangle(right);
        change(&mut data);
        one_mesh(data).build().expect_err("no mesh").to_string()
    };
    for (words, message) in [
        ("corner 3 of 3", with(&|data| data.triangles.push([0, 1, 3]))),
        ("number 1, from 0) that is not a number (nan)", with(&|data| data.positions[1].y = f64::NAN)),
        ("number 2, from 0) that is infinite", with(&|data| data.positions[2].x = f64::NEG_INFINITY)),
        ("beyond ±1e9; scale it down", with(&|data| data.positions[0].x = 2e9)),
        ("has no triangles", with(&|data| data.triangles.clear())),
        ("has no area", with(&|data| data.positions[2] = DVec3::X * 3.0)),
        ("1 normals for 3 corners", with(&|data| data.normals.push(DVec3::X))),
    ] {
        assert!(message.contains(words) && message.starts_with("shapes[0]: the mesh "), "{message}");
    }
    let nowhere = one_mesh(triangle(right)).placed_mesh(
        triangle(right),
        Placement { scale: 0.0, ..Placement::default() },
        "m",
    );
    let message = nowhere.build().expect_err("no size").to_string();
    assert!(message.starts_with("shapes[1]: scale 0 must be positive"), "{message}");
    // A million units away f32 still tells these corners apart, a billion units away it does not.
    let far = |by: f64| {
        let placement = Placement { translate: DVec3::splat(by), ..Placement::default() };
        one_mesh(triangle(right).placed(&placement)).build()
    };
    assert!(far(1e6).is_ok() && far(9e8).is_err());
}

#[test]
fn headers_that_promise_what_the_file_does_not_hold_are_refused_before_anything_is_allocated() {
    let huge = |from: &str, to: &str| {
        [PLY.as_bytes().to_vec(), binary_ply(false)].map(|bytes| {
            let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
            [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
        })
    };
    let vertices = huge("vertex 5", "vertex 18446744073709551615");
    let faces = huge("face 5", "face 4000000000");
    let nothing = huge("element face", "element dust 4000000000\nelement face");
    for bytes in vertices.into_iter().chain(faces).chain(nothing) {
        let error = read(MeshFormat::Ply, &bytes).unwrap_err();
        assert!(error.ends_with("write it anew"), "{error}");
    }
}

#[test]
fn materials_that_an_obj_file_names_are_passed_over_even_without_a_name() {
    let plain = read(MeshFormat::Obj, OBJ.as_bytes()).unwrap();
    let odd = OBJ.replace("usemtl stone", "usemtl\nmtllib\nusemtl");
    assert_ne!(odd, OBJ);
    assert_eq!(read(MeshFormat::Obj, odd.as_bytes()), Ok(plain));
}

/// Found by fuzzing: tobj multiplied such numbers beyond 2⁶⁴.
#[test]
fn obj_faces_that_count_back_beyond_the_first_corner_are_refused() {
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n";
    for face in [
        "1//-22 2//-1 3//-1",
        "1/-2 2/1 3/1",
        "-4 1 2",
        "1 2 9223372036854775807",
        "1//-9223372036854775808 2 3",
    ] {
        let text = format!("{corners}f {face}\n");
        let problem = read(MeshFormat::Obj, text.as_bytes()).unwrap_err();
        assert!(problem.contains("a corner that it does not have"), "{face}: {problem}");
    }
    let back = read(MeshFormat::Obj, format!("{corners}f -3/-1/-1 -2/-1/-1 -1/-1/-1\n").as_bytes()).unwrap();
    assert_eq!(back, read(MeshFormat::Obj, format!("{corners}f 1/1/1 2/1/1 3/1/1\n").as_bytes()).unwrap());
}

#[test]
fn ply_files_are_read_whole_however_many_parts_they_are_read_in() {
    let count = 40_000;
    let axes = "property float x\nproperty float y\nproperty float z\n";
    let face = "property list uchar int vertex_index\n";
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\n{axes}element face {count}\n{face}end_header\n"
    );
    (0..count).for_each(|i| text += &format!("{i} 1 2\n"));
    (0..count).for_each(|i| text += &format!("3 0 1 {i}\n"));
    let data = read(MeshFormat::Ply, text.as_bytes()).unwrap();
    assert_eq!((data.positions.len(), data.triangles.len()), (count, count));
    for i in [0, 16_383, 16_384, 39_999] {
        assert_eq!(data.positions[i], DVec3::new(i as f64, 1.0, 2.0));
        assert_eq!(data.triangles[i], [0, 1, i as u32]);
    }
    let short = read(MeshFormat::Ply, &text.as_bytes()[..text.len() - 9]).unwrap_err();
    assert!(short.starts_with("is not a whole PLY file"), "{short}");
}

/// A scene with a mesh in a folder of its own.
fn scene_with(folder: &Path, shape: &str) -> Result<Scene, String> {
    let camera = "name = 's'\n[camera]\norigin = [0, 0, 4]\ntarget = [0, 0, 0]\nfov_y_deg = 40\nwidth = 8\nheight = 8\n";
    let materials = "[materials.m]\ntype = 'diffuse'\ncolor = [1, 1, 1]\n";
    let path = folder.join("scene.toml");
    let shape = format!("[[shapes]]\ntype = 'mesh'\nmaterial = 'm'\n{shape}\n");
    std::fs::write(&path, format!("{camera}{materials}{shape}")).unwrap();
    Scene::load(path).map_err(|error| error.to_string())
}

#[test]
fn a_scene_finds_its_meshes_in_its_own_folder_and_nowhere_else() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    std::fs::create_dir(inner.join("meshes")).unwrap();
    for path in ["inner/meshes/a.PLY", "outside.ply"] {
        std::fs::File::create(folder.path().join(path)).unwrap().write_all(PLY.as_bytes()).unwrap();
    }
    std::fs::write(inner.join("short.ply"), &PLY[..PLY.len() - 8]).unwrap();
    std::fs::write(inner.join("a.stl"), "solid").unwrap();

    let scene =
        scene_with(&inner, "file = 'meshes/../meshes/a.PLY'\nscale = 0.5\ntranslate = [1, 0, 0]").unwrap();
    let crate::scene::Geometry::Mesh(mesh) = &scene.shapes[0].geometry else { panic!("a mesh") };
    assert_eq!(mesh.triangles().next().unwrap()[0], Vec3::new(0.5, 0.0, -0.5));

    let outside = folder.path().join("outside.ply").display().to_string();
    for (shape, words) in [
        ("file = '../outside.ply'".to_owned(), "\"../outside.ply\" lies outside the scene's folder"),
        (format!("file = '{outside}'"), "lies outside the scene's folder"),
        ("file = 'b.ply'".to_owned(), "file \"b.ply\" no such file"),
        ("file = 'meshes'".to_owned(), "is not a regular file"),
        (
            "file = 'a.stl'".to_owned(),
            "has the extension \"stl\"; mesh files end in .glb, .gltf, .ply or .obj",
        ),
        ("file = 'short.ply'".to_owned(), "is not a whole PLY file"),
        ("scale = 1".to_owned(), "file is missing"),
        ("file = 'meshes/a.PLY'\nscale = -1".to_owned(), "scale -1 must be positive"),
        ("file = 'meshes/a.PLY'\nsize = 1".to_owned(), "unknown key \"size\""),
    ] {
        let message = scene_with(&inner, &shape).unwrap_err();
        assert!(message.contains(words), "{message}");
        let [place, object] = ["scene.toml:", ": shapes[0]: "].map(|part| message.find(part));
        assert!(place < object && object.is_some(), "{message}");
    }
    let text = std::fs::read_to_string(inner.join("scene.toml")).unwrap().replace("size = 1", "");
    let message = Scene::from_toml(&text).unwrap_err().to_string();
    assert!(message.contains("load the scene from a file"), "{message}");
}

/// What is read is a mesh or refused, with words.
fn check(format: MeshFormat, bytes: &[u8]) {
    match read(format, bytes) {
        Ok(data) => drop(Mesh::new(&data).map_err(|problem| assert!(!problem.is_empty()))),
        Err(problem) => assert!(!problem.is_empty()),
    }
}

#[test]
fn no_truncated_file_panics() {
    for (format, bytes) in forms() {
        (0..bytes.len()).for_each(|length| check(format, &bytes[..length]));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_flipped_bytes_panic(form in 0..4usize, flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let (format, mut bytes) = forms()[form].clone();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        check(format, &bytes);
    }

    #[test]
    fn no_odd_number_panics(form in 0..4usize, line in 0..24usize, word in 0..8usize, odd in prop::sample::select(vec![
        "nan", "inf", "-1", "1e999", "4294967296", "18446744073709551616", "0", "", "-", "1/2/3", "9/9", "\u{1F600}", "2147483648",
    ])) {
        let (format, bytes) = forms()[form].clone();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let mut lines: Vec<String> = text.split('\n').map(str::to_owned).collect();
        if let Some(line) = lines.get_mut(line) {
            let mut words: Vec<&str> = line.split(' ').collect();
            if let Some(word) = words.get_mut(word) {
                *word = odd;
            }
            *line = words.join(" ");
        }
        check(format, lines.join("\n").as_bytes());
    }

    #[test]
    fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        check(MeshFormat::Ply, &bytes);
        check(MeshFormat::Obj, &bytes);
        check(MeshFormat::Ply, &[b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nend_header\n", &bytes[..]].concat());
    }
}
