//! The program as its users meet it: what it writes where, what it refuses and how, and its exit codes.

use qtracer::Image;
use qtracer::film::{WriteOptions, read_image, write_image};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;
use tempfile::TempDir;

const QTRACER: &str = env!("CARGO_BIN_EXE_qtracer");

/// A ball on a floor under a bright sky: noisy, quick, and nothing but diffuse.
const BALL: &str = r#"
name = "ball"
[camera]
origin = [0, 1, 5]
target = [0, 0, 0]
fov_y_deg = 40
width = 16
height = 12
[environment]
radiance = [0.5, 0.7, 1.0]
[render]
spp = 2
[materials.clay]
type = "diffuse"
color = [0.7, 0.4, 0.3]
[[shapes]]
name = "ball"
type = "sphere"
center = [0, 0, 0]
radius = 1
material = "clay"
[[shapes]]
name = "floor"
type = "quad"
corner = [-5, -1, 5]
e1 = [10, 0, 0]
e2 = [0, 0, -10]
material = "clay"
"#;

/// A folder of its own with ball.toml in it, where the program runs.
struct Place(TempDir);

struct Outcome {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

impl From<Output> for Outcome {
    fn from(output: Output) -> Self {
        Outcome {
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

impl Place {
    fn new() -> Self {
        let place = Place(TempDir::new().unwrap());
        place.write("ball.toml", BALL);
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        fs::write(self.path(name), text).unwrap();
    }

    /// The ball with one piece of its text replaced, as a new file.
    fn variant(&self, name: &str, from: &str, to: &str) {
        assert!(BALL.contains(from), "{from}");
        self.write(name, BALL.replacen(from, to, 1));
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(QTRACER);
        command.current_dir(self.0.path()).args(args);
        command
    }

    fn run(&self, args: &[&str]) -> Outcome {
        self.command(args).output().unwrap().into()
    }

    fn succeed(&self, args: &[&str]) -> Outcome {
        let outcome = self.run(args);
        assert_eq!(outcome.code, Some(0), "{args:?}: {}", outcome.stderr);
        outcome
    }

    /// Runs `render ball.toml --engine cpu` with more arguments.
    fn render(&self, args: &[&str]) -> Outcome {
        self.succeed(&[&["render", "ball.toml", "--engine", "cpu"], args].concat())
    }

    fn image(&self, name: &str) -> Image {
        read_image(&self.path(name)).unwrap()
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0.path()).unwrap();
        let names = entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned());
        let mut names: Vec<String> = names.collect();
        names.sort();
        names
    }

    /// Exit 2, an error with all these words on stderr, nothing on stdout, no new file.
    fn refuses(&self, args: &[&str], words: &[&str]) {
        let before = self.files();
        let Outcome { code, stdout, stderr } = self.run(args);
        assert_eq!(code, Some(2), "{args:?}: {stderr}");
        assert!(stderr.starts_with("error: "), "{args:?}: {stderr}");
        for word in words {
            assert!(stderr.contains(word), "{args:?}: no {word:?} in {stderr}");
        }
        assert_eq!(stdout, "", "{args:?}");
        assert_eq!(self.files(), before, "{args:?}");
    }

    /// The scene is refused, by `check` and by `render`.
    fn refuses_scene(&self, name: &str, words: &[&str]) {
        self.refuses(&["check", name], words);
        self.refuses(&["render", name, "-o", "out.png"], words);
    }
}

#[test]
fn bad_scenes_are_refused_with_the_object_and_the_remedy() {
    let place = Place::new();
    let radius = "radius = 1";
    let clay = "color = [0.7, 0.4, 0.3]";
    for (from, to, words) in [
        (radius, "radius = nan", &["ball", "radius"][..]),
        (radius, "radius = inf", &["ball", "radius"]),
        (radius, "radius = 0", &["ball", "radius"]),
        (radius, "radius = -2", &["ball", "radius", "inward"]),
        (clay, "color = [nan, 0, 0]", &["clay", "color"]),
        (clay, "colour = [0.7, 0.4, 0.3]", &["clay", "did you mean \"color\"?"]),
        (clay, "color = [-0.1, 0, 0]", &["clay", "color"]),
        ("e2 = [0, 0, -10]", "e2 = [20, 0, 0]", &["floor", "parallel"]),
        ("target = [0, 0, 0]", "target = [0, 2, 5]", &["camera", "up"]),
        ("target = [0, 0, 0]", "target = [0, 1, 5]", &["camera", "target"]),
        ("fov_y_deg = 40", "fov_y_deg = 180", &["camera", "fov_y_deg"]),
        ("material = \"clay\"", "material = \"cley\"", &["did you mean \"clay\"?"]),
        ("type = \"diffuse\"", "type = \"difuse\"", &["did you mean \"diffuse\"?"]),
        ("[environment]", "[enviroment]", &["did you mean \"environment\"?"]),
        ("width = 16", "width = 0", &["0 × 12"]),
        ("spp = 2", "spp = 0", &["spp"]),
        ("spp = 2", "spp = 2\nmax_bounces = 65", &["max_bounces", "64"]),
        ("name = \"ball\"", "name = ", &["bad.toml:2"]),
    ] {
        place.variant("bad.toml", from, to);
        place.refuses_scene("bad.toml", &[&["bad.toml"], words].concat());
    }
    let glass = |ior: &str| format!("type = \"dielectric\"\nior = {ior}");
    for ior in ["0", "-1.5", "nan"] {
        let text = BALL.replacen(clay, "", 1);
        place.write("bad.toml", text.replacen("type = \"diffuse\"", &glass(ior), 1));
        place.refuses_scene("bad.toml", &["clay", "ior"]);
    }
    let huge = BALL.replacen("width = 16", "width = 1000000", 1);
    place.write("bad.toml", huge.replacen("height = 12", "height = 1000000", 1));
    place.refuses_scene("bad.toml", &["1000000", "170000000000000 bytes"]);
}

#[test]
fn files_that_are_no_scenes_are_refused_by_name() {
    let place = Place::new();
    place.write("garbage.toml", [0u8, 159, 146, 150, 255, 1, 2, 3]);
    place.write("empty.toml", "");
    place.write("half.json", "{\"name\": \"x\", ");
    place.write("scene.yaml", "name: x");
    fs::create_dir(place.path("folder.toml")).unwrap();
    place.refuses_scene("missing.toml", &["missing.toml", "no such file", "check"]);
    place.refuses_scene("folder.toml", &["folder.toml", "directory"]);
    place.refuses_scene("garbage.toml", &["garbage.toml", "UTF-8"]);
    place.refuses_scene("empty.toml", &["empty.toml", "empty"]);
    place.refuses_scene("half.json", &["half.json"]);
    place.refuses_scene("scene.yaml", &["scene.yaml", ".toml or .json"]);
    let outcome = place.run(&["check", "ball.toml", "missing.toml", "empty.toml"]);
    assert_eq!(outcome.code, Some(2));
    assert!(outcome.stderr.contains("2 of 3"), "{}", outcome.stderr);
    assert!(outcome.stdout.contains("ball"), "{}", outcome.stdout);
}

#[test]
fn bad_options_are_refused_by_name_with_what_would_do() {
    let place = Place::new();
    for (args, words) in [
        (&["--spp", "0"][..], &["--spp", "at least 1"][..]),
        (&["--spp", "-3"], &["--spp", "such as 64"]),
        (&["--spp", "many"], &["--spp", "such as 64"]),
        (&["--spp", "4294967296"], &["--spp", "at most"]),
        (&["--time", "0"], &["--time", "90s"]),
        (&["--time", "-5s"], &["--time", "90s"]),
        (&["--time", "nan"], &["--time", "90s"]),
        (&["--time", "5 parsecs"], &["--time", "90s"]),
        (&["--error", "0"], &["--error", "above 0"]),
        (&["--error", "nan"], &["--error", "above 0"]),
        (&["--error", "-0.1"], &["--error", "above 0"]),
        (&["--spp", "2", "--time", "1s"], &["--spp", "--time", "cannot be used"]),
        (&["--time", "1s", "--error", "0.1"], &["--time", "--error", "cannot be used"]),
        (&["--max-spp", "5"], &["--max-spp", "--spp"]),
        (&["--error", "0.1", "--max-spp", "0"], &["--max-spp", "at least 1"]),
        (&["--size", "0x10"], &["--size", "0 × 10"]),
        (&["--size", "10x0"], &["--size", "10 × 0"]),
        (&["--size", "-1x5"], &["--size", "640x480"]),
        (&["--size", "640"], &["--size", "640x480"]),
        (&["--size", "1000000x1000000"], &["--size", "170000000000000 bytes"]),
        (&["--size", "65536x65536"], &["--size", "bytes", "GiB"]),
        (&["--seed", "-1"], &["--seed"]),
        (&["--first-sample", "4294967295"], &["--first-sample", "lower"]),
        (&["--max-bounces", "0"], &["--max-bounces", "1..=64"]),
        (&["--max-bounces", "65"], &["--max-bounces", "1..=64"]),
        (&["--direct-light", "maybe"], &["--direct-light"]),
        (&["--engine", "warp"], &["--engine", "wavefront", "megakernel"]),
        (&["--adapter", ""], &["--adapter", "qtracer info"]),
        (&["--threads", "0"], &["--threads", "1..=1024"]),
        (&["--pool", "0"], &["--pool"]),
        (&["--exposure", "inf"], &["--exposure", "-64 to 64"]),
        (&["--engine", "cpu", "--pool", "7"], &["7", "--pool", "256"]),
        (&["--roulette", "maybe"], &["--roulette", "throughput", "learnt"]),
        (&["--roulette-scale", "0"], &["--roulette-scale", "above 0"]),
        (&["--roulette-scale", "1e99"], &["--roulette-scale", "above 0"]),
        (&["--split", "9", "--roulette", "learnt"], &["--split", "9", "1..=8"]),
        (&["--split", "0", "--roulette", "learnt"], &["--split", "0", "1..=8"]),
        (&["--split", "2"], &["--split", "--roulette learnt"]),
        (
            &["--split", "2", "--guide", "adaptive", "--roulette", "throughput"],
            &["--split", "--roulette learnt"],
        ),
        (&["--guide", "octants"], &["--guide", "octant", "adaptive"]),
        (&["--guide-cell", "0"], &["--guide-cell", "above 0"]),
        (&["--guide-cell", "-1"], &["--guide-cell", "-1", "above 0"]),
        (&["--guide-cell", "inf"], &["--guide-cell", "scene units"]),
        (&["--guide-depth", "8"], &["--guide-depth", "8", "0..=7"]),
        (&["--guide-mixture", "1"], &["--guide-mixture", "0 to 0.95"]),
        (&["--guide-alpha", "nan"], &["--guide-alpha", "0 to 1"]),
        (&["--guide-discount", "1.5"], &["--guide-discount", "0 to 1"]),
        (&["--guide-threshold", "-0.5"], &["--guide-threshold", "-0.5", "0 to 1"]),
        (&["--guide-learning", "-1"], &["--guide-learning", "-1"]),
        (&["--guide-memory", "0"], &["--guide-memory", "256M"]),
        (&["--guide-memory", "12X"], &["--guide-memory", "12X", "256M"]),
        (&["--guide", "adaptive", "--guide-memory", "1K", "--engine", "cpu"], &["1024", "--guide-memory"]),
        (
            &["--guide", "bansal", "--roulette", "learnt"],
            &["--roulette learnt", "--guide bansal", "adaptive"],
        ),
        (&["--guide", "bansal-reweighted", "--roulette", "learnt"], &["--guide bansal-reweighted"]),
        (&["--save-guide", "x.guide"], &["--save-guide", "add --guide"]),
        (&["--load-guide", "x.guide"], &["--load-guide", "add --guide"]),
        (&["--show", "cells"], &["--show", "add --guide"]),
        (&["--guide-layers"], &["--guide-layers", "add --guide"]),
        (&["--guide", "octant", "--show", "bounces"], &["--show", "illumination"]),
        (&["--guide", "octant", "--save-guide", "no/x.guide"], &["no", "does not exist", "create it"]),
        (
            &["--guide", "octant", "--save-guide", "a.png", "-o", "a.png"],
            &["a.png", "--save-guide", "two files"],
        ),
        (&["--no-such-option"], &["--no-such-option"]),
    ] {
        place.refuses(&[&["render", "ball.toml"], args].concat(), words);
    }
    place.refuses(&["rendr", "ball.toml"], &["rendr", "render"]);
    assert_eq!(place.run(&[]).code, Some(2));
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_rendering() {
    let place = Place::new();
    fs::create_dir(place.path("folder.png")).unwrap();
    let endless = ["--spp", "4000000000", "--engine", "cpu"];
    let refuses = |output: &str, words: &[&str]| {
        let args = [&["render", "ball.toml", "-o", output][..], &endless].concat();
        place.refuses(&args, words);
    };
    refuses("nowhere/out.png", &["nowhere", "does not exist", "create it"]);
    refuses("ball.toml/out.png", &["not a folder"]);
    refuses("folder.png", &["folder.png", "is a folder"]);
    refuses("out.tiff", &["out.tiff", ".png", ".exr"]);
    refuses("out", &["no extension", ".png", ".exr"]);
    refuses("", &["--output", "a value is required"]);
    let twice = ["render", "ball.toml", "-o", "a.png", "-o", "a.png"];
    place.refuses(&twice, &["a.png", "twice"]);
    place.write("file", "");
    let dump = ["render", "ball.toml", "--dump-kernels", "file"];
    place.refuses(&dump, &["--dump-kernels", "file", "another folder"]);
}

#[test]
fn odd_scenes_render_with_a_warning() {
    let place = Place::new();
    place.variant("dark.toml", "radiance = [0.5, 0.7, 1.0]", "radiance = [0, 0, 0]");
    place.variant("bright.toml", "color = [0.7, 0.4, 0.3]", "color = [1.5, 0.4, 0.3]");
    for (scene, words) in [("dark", ["warning:", "black"]), ("bright", ["clay", "energy"])] {
        let file = format!("{scene}.toml");
        for args in [&["render", &file, "--engine", "cpu", "-q"][..], &["check", &file]] {
            let stderr = place.succeed(args).stderr;
            assert!(words.iter().all(|word| stderr.contains(word)), "{stderr}");
        }
        assert!(place.path(&format!("{scene}.png")).is_file());
    }
}

/// A tetrahedron with a face twice and one without area.
const TETRAHEDRON: &str =
    "v 0 0 1\nv 1 0 -1\nv -1 0 -1\nv 0 1 0\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\nf 4 2 3\nf 1 1 2\n";
const SPHERE: &str = "type = \"sphere\"\ncenter = [0, 0, 0]\nradius = 1";

#[test]
fn a_mesh_beside_the_scene_is_rendered_and_what_it_lost_is_one_line() {
    let place = Place::new();
    place.write("tetrahedron.obj", TETRAHEDRON);
    place.variant("mesh.toml", SPHERE, "type = \"mesh\"\nfile = \"tetrahedron.obj\"");
    for args in [&["render", "mesh.toml", "--engine", "cpu", "-q"][..], &["check", "mesh.toml"]] {
        let outcome = place.succeed(args);
        let words = ["warning: ", "\"ball\"", "1 triangle without area", "1 that repeats"];
        assert!(words.iter().all(|word| outcome.stderr.contains(word)), "{}", outcome.stderr);
        assert_eq!(outcome.stderr.lines().count(), 1, "{}", outcome.stderr);
        let counts = "1 quad, 1 mesh of 4 triangles";
        assert!(args[0] == "render" || outcome.stdout.contains(counts), "{}", outcome.stdout);
    }
    let stats = ["render", "mesh.toml", "--engine", "cpu", "-q", "--stats", "text", "-o", "layers.exr"];
    let stats = place.succeed(&stats).stdout;
    for row in ["hierarchy.triangles", "hierarchy.nodes", "hierarchy.build_seconds"] {
        assert!(stats.contains(row), "{stats}");
    }
}

/// Two places of 16,562 triangles: little memory, so that nothing is shared unless asked for.
#[test]
fn instances_are_shared_where_that_is_asked_for_and_told_of() {
    let place = Place::new();
    let mut grid = String::new();
    (0..92 * 92)
        .for_each(|i| grid += &format!("v {} 0 {}\n", 0.01 * f64::from(i % 92), 0.01 * f64::from(i / 92)));
    for i in (0..91 * 92).filter(|i| i % 92 < 91) {
        let [a, b, c, d] = [1, 93, 94, 2].map(|corner| corner + i);
        grid += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
    }
    place.write("grid.obj", grid);
    let mesh = "type = \"mesh\"\nfile = \"grid.obj\"\nmaterial = \"clay\"\n[[shapes]]\n\
        type = \"mesh\"\nfile = \"grid.obj\"\nscale = 0.5";
    place.variant("grid.toml", SPHERE, mesh);
    let told = place.succeed(&["check", "grid.toml"]).stdout;
    assert!(told.contains("2 meshes of 33124 triangles") && !told.contains("instances"), "{told}");
    let render =
        ["render", "grid.toml", "--engine", "cpu", "-q", "--stats", "text", "-o", "a.exr", "--instances"];
    let stats = |how| place.succeed(&[&render[..], &[how]].concat()).stdout;
    let shared = stats("shared");
    let rows = ["instances.instances", "instances.stored_triangles", "instances.laid_out_bytes"];
    assert!(rows.iter().all(|row| shared.contains(row)) && shared.contains("33124"), "{shared}");
    assert!(["auto", "laid-out"].iter().all(|how| !stats(how).contains("instances.")));
    place.refuses(&[&render[..], &["some"]].concat(), &["--instances", "some", "laid-out"]);
}

#[test]
fn meshes_that_cannot_be_used_are_refused_with_the_file_and_the_remedy() {
    let place = Place::new();
    place.write("cut.obj", &TETRAHEDRON[..TETRAHEDRON.len() / 2]);
    place.write("short.obj", TETRAHEDRON.replace("f 1 3 2", "f 1 3 9"));
    place.write("nan.obj", TETRAHEDRON.replace("v 0 0 1", "v 0 nan 1"));
    let header =
        "ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n";
    place.write("header.ply", header);
    for (file, words) in [
        ("cut.obj", &["cut.obj", "no triangles"][..]),
        ("short.obj", &["short.obj", "write it anew"]),
        ("nan.obj", &["nan.obj", "not a number"]),
        ("header.ply", &["header.ply", "cut short or damaged"]),
        ("none.ply", &["none.ply", "no such file"]),
        ("../none.ply", &["../none.ply", "no such file"]),
    ] {
        place.variant("bad.toml", SPHERE, &format!("type = \"mesh\"\nfile = \"{file}\""));
        place.refuses_scene("bad.toml", &[&["bad.toml", "\"ball\""], words].concat());
    }
}

/// A triangle in a buffer of its own text, with two cameras.
const TRIANGLE_GLTF: &str = r#"{
  "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0, 1, 2] }],
  "nodes": [{ "mesh": 0, "name": "sail" },
            { "camera": 0, "name": "front", "translation": [0.3, 0.3, 3] },
            { "camera": 0, "name": "near", "translation": [0.3, 0.3, 1] }],
  "cameras": [{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1, "aspectRatio": 2 } }],
  "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
  "accessors": [{ "bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3, "min": [0, 0, 0], "max": [1, 1, 0] }],
  "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
  "buffers": [{ "byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA" }]
}"#;

#[test]
fn models_are_rendered_by_themselves_and_what_was_chosen_is_said() {
    let place = Place::new();
    place.write("sail.gltf", TRIANGLE_GLTF);
    place.write("tetrahedron.obj", TETRAHEDRON);
    let checked = place.succeed(&["check", "sail.gltf"]);
    assert!(
        checked.stdout.contains("640x320") && checked.stdout.contains("1 mesh of 1 triangle"),
        "{}",
        checked.stdout
    );
    assert!(checked.stderr.contains("sail.gltf: no light: an even white sky"), "{}", checked.stderr);
    assert!(!checked.stderr.contains("no camera"), "{}", checked.stderr);
    let brief = ["--engine", "cpu", "-q", "--spp", "2", "--size", "16x8"];
    let render = |args: &[&str]| place.succeed(&[&["render"], args, &brief].concat());
    render(&["sail.gltf"]);
    let first = place.bytes("sail.png");
    render(&["sail.gltf", "--camera", "front"]);
    assert_eq!(place.bytes("sail.png"), first, "the first camera is the usual one");
    render(&["sail.gltf", "--camera", "near"]);
    assert_ne!(place.bytes("sail.png"), first);
    let said = render(&["tetrahedron.obj"]).stderr;
    for words in ["no camera: the whole is seen", "no light: an even white sky", "1 triangle without area"] {
        assert!(said.contains(words), "{said}");
    }
    place.refuses(
        &["render", "sail.gltf", "--camera", "nera"],
        &["sail.gltf", "no camera \"nera\"", "did you mean \"near\""],
    );
    place.refuses(&["render", "ball.toml", "--camera", "near"], &["ball.toml", "has one camera"]);
    place.write("cut.glb", &b"glTF\x02\0\0\0\xff\0\0\0"[..]);
    place.refuses(&["render", "cut.glb"], &["cut.glb", "promises 255 bytes"]);
}

/// Colours far above 1 are allowed, and overflow f32 in a closed room: told of once, and black rather than infinite.
#[test]
fn samples_that_are_no_numbers_are_told_of_once_and_by_number() {
    let place = Place::new();
    let furnace = include_str!("../scenes/furnace-closed-99.toml");
    place.write("hot.toml", furnace.replace("color = [0.99, 0.99, 0.99]", "color = [1e6, 1e6, 1e6]"));
    place.write("right.toml", furnace);
    let render = |scene: &str| {
        let size = ["--size", "8x8", "--spp", "3", "--engine", "cpu", "--no-features", "--stats", "json"];
        place.succeed(&[&["render", scene, "-o", "out.exr"], &size[..]].concat())
    };
    let lost = |outcome: &Outcome| -> serde_json::Value {
        serde_json::from_str::<serde_json::Value>(&outcome.stdout).unwrap()["lost_samples"].clone()
    };
    let hot = render("hot.toml");
    assert_eq!(lost(&hot), 192);
    assert_eq!(hot.stderr.matches("warning: 192 of 192 samples came out").count(), 1, "{}", hot.stderr);
    assert!(hot.stderr.contains("Lower colors above 1"), "{}", hot.stderr);
    assert!(place.image("out.exr").rgb.iter().all(|rgb| *rgb == [0.0; 3]));
    let right = render("right.toml");
    assert!(lost(&right) == 0 && !right.stderr.contains("warning"), "{}", right.stderr);
}

#[test]
fn one_render_fills_several_files_and_says_so_on_stderr_only() {
    let place = Place::new();
    let outcome = place.render(&["-o", "out.png", "-o", "out.exr", "--seed", "7"]);
    assert_eq!(outcome.stdout, "");
    assert!(outcome.stderr.contains("out.png, out.exr"), "{}", outcome.stderr);
    let (png, exr) = (place.image("out.png"), place.image("out.exr"));
    assert_eq!((png.width, png.height, exr.width, exr.height), (16, 12, 16, 12));
    assert!(exr.standard_error.is_some() && exr.features.is_some());
    assert!(exr.samples.unwrap().iter().all(|&count| count == 2.0));
    for (key, value) in [("scene", "ball"), ("seed", "7"), ("samples", "2"), ("engine", "cpu")] {
        assert_eq!(exr.metadata.get(key), Some(value));
    }
    let sky = exr.rgb[0];
    assert_eq!(sky, [0.5, 0.7, 1.0]);
    place.render(&["-o", "plain.exr", "--no-features", "--quiet"]);
    assert!(place.image("plain.exr").features.is_none());
}

#[test]
fn the_default_output_is_named_after_the_scene_and_lies_in_the_current_folder() {
    let place = Place::new();
    fs::create_dir(place.path("deep")).unwrap();
    place.write("deep/scene.toml", BALL);
    let quiet = place.succeed(&["render", "deep/scene.toml", "--engine", "cpu", "--quiet"]);
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
    assert_eq!(place.files(), ["ball.toml", "deep", "scene.png"]);
}

#[test]
fn equal_seeds_give_equal_bytes_and_others_do_not() {
    let place = Place::new();
    for (seed, name) in [("5", "a"), ("5", "b"), ("6", "c")] {
        let (png, exr) = (format!("{name}.png"), format!("{name}.exr"));
        place.render(&["--size", "40x50", "--seed", seed, "-o", &png, "-o", &exr]);
    }
    for (a, b, c) in [("a.png", "b.png", "c.png"), ("a.exr", "b.exr", "c.exr")] {
        assert!(place.bytes(a) == place.bytes(b), "{a} and {b} differ");
        assert_ne!(place.image(a).rgb, place.image(c).rgb);
    }
    place.render(&["--size", "40x50", "--seed", "5", "--threads", "1", "-o", "one.exr"]);
    assert_eq!(place.image("one.exr").rgb, place.image("a.exr").rgb);
}

/// Reading meshes runs on all threads; how many is said before.
#[test]
fn threads_are_limited_before_a_mesh_is_read() {
    let place = Place::new();
    let model = place.path("triangle.obj");
    fs::write(&model, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    place.succeed(&[
        "render",
        "triangle.obj",
        "--engine",
        "cpu",
        "--size",
        "8x6",
        "--spp",
        "1",
        "--threads",
        "1",
    ]);
}

#[test]
fn stats_are_all_that_stdout_holds() {
    let place = Place::new();
    let outcome = place.render(&["--size", "20x10", "--spp", "3", "--stats", "json"]);
    let stats: serde_json::Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!(stats["scene"], "ball");
    assert_eq!((&stats["width"], &stats["height"]), (&20.into(), &10.into()));
    assert_eq!((&stats["samples"], &stats["paths"]), (&3.into(), &600.into()));
    assert_eq!((&stats["engine"], &stats["complete"]), (&"cpu".into(), &true.into()));
    assert_eq!(stats["lost_samples"], 0);
    for number in ["wall_seconds", "mpaths_per_second", "relative_error", "seed"] {
        assert!(stats[number].is_number(), "{number}");
    }
    let text = place.render(&["--stats", "text"]).stdout;
    assert!(text.contains("relative_error") && text.contains("ball"), "{text}");
}

#[test]
fn time_and_error_stop_where_they_say() {
    let place = Place::new();
    let stats = |args: &[&str]| -> serde_json::Value {
        let outcome = place.render(&[args, &["--stats", "json"]].concat());
        serde_json::from_str(&outcome.stdout).unwrap()
    };
    let timed = stats(&["--time", "300ms"]);
    let seconds = timed["wall_seconds"].as_f64().unwrap();
    assert!((0.25..3.0).contains(&seconds), "{seconds}");
    assert!(timed["samples"].as_u64().unwrap() > 10);
    let precise = stats(&["--error", "0.02"]);
    let error = precise["relative_error"].as_f64().unwrap();
    assert!((0.005..=0.02).contains(&error), "{error}");
    let capped = place.render(&["--error", "1e-9", "--max-spp", "20", "--stats", "json"]);
    assert!(capped.stderr.contains("warning: stopped at 20 samples"), "{}", capped.stderr);
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_with_the_image_so_far() {
    let place = Place::new();
    for signal in ["-INT", "-TERM"] {
        let outcome = interrupt(signal, || {
            let endless = ["--spp", "4000000000", "--engine", "cpu", "-o", "out.exr"];
            place.command(&[&["render", "ball.toml"], &endless[..]].concat())
        });
        assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
        assert!(outcome.stderr.contains("error: interrupted"), "{}", outcome.stderr);
        assert!(outcome.stderr.contains("of 4000000000"), "{}", outcome.stderr);
        let image = place.image("out.exr");
        assert!(image.samples.unwrap().iter().all(|&count| count >= 1.0));
        fs::remove_file(place.path("out.exr")).unwrap();
    }
}

/// Rows that the first pass had finished are kept; where there are none, nothing is written; either is said.
#[cfg(unix)]
#[test]
fn an_interrupt_during_the_first_pass_keeps_the_finished_rows_and_says_so() {
    let place = Place::new();
    let closed = BALL.replacen("radius = 1", "radius = 50", 1);
    place.write("slow.toml", closed.replacen("[0.7, 0.4, 0.3]", "[1, 1, 1]", 1));
    let outcome = interrupt("-INT", || {
        let slow = ["--size", "1200x1200", "--roulette", "off", "--spp", "9", "-o", "slow.exr"];
        let one_core = ["--engine", "cpu", "--threads", "1"];
        place.command(&[&["render", "slow.toml"], &slow[..], &one_core].concat())
    });
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    if outcome.stderr.contains("nothing was written") {
        assert_eq!(place.files(), ["ball.toml", "slow.toml"]);
    } else {
        assert!(outcome.stderr.contains("0 to 1 samples per pixel of 9"), "{}", outcome.stderr);
        let counts = place.image("slow.exr").samples.unwrap();
        assert!(
            counts.iter().all(|&c| c == 0.0 || c == 1.0) && counts.contains(&0.0) && counts.contains(&1.0)
        );
        assert_eq!(place.files(), ["ball.toml", "slow.exr", "slow.toml"]);
    }
}

/// Sends a signal to a running render: again, and later, where it came before the program was ready for it.
#[cfg(unix)]
fn interrupt(signal: &str, command: impl Fn() -> Command) -> Outcome {
    for wait in [300, 1000, 3000] {
        let mut command = command();
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(wait));
        let sent = Command::new("kill").args([signal, &child.id().to_string()]).status();
        assert!(sent.unwrap().success());
        let outcome = Outcome::from(child.wait_with_output().unwrap());
        if outcome.code.is_some() {
            return outcome;
        }
    }
    panic!("{signal} always killed the program");
}

/// A file size limit is a full disk that needs no privileges; where namespaces allow, a real one is filled too.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_fails_that_output_only_and_keeps_what_was_there() {
    let place = Place::new();
    fs::create_dir(place.path("full")).unwrap();
    place.write("noise.exr", "an older image");
    // 512-byte blocks in dash, 1024-byte ones in bash: the .png fits, the .exr does not.
    let limited = "trap '' XFSZ; ulimit -f 8; exec \"$@\"";
    let outcome = under_shell(&place, &[], limited, "noise.exr", "small.png");
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("error: cannot write \"noise.exr\""), "{}", outcome.stderr);
    assert_eq!(place.bytes("noise.exr"), b"an older image");
    assert_eq!(place.files(), ["ball.toml", "full", "noise.exr", "small.png"]);

    let filled = "mount -t tmpfs -o size=8k tmpfs full || exit 77; exec \"$@\"";
    let outcome = under_shell(&place, &["unshare", "-rm"], filled, "full/noise.exr", "big.png");
    if outcome.stderr.contains("unshare") || outcome.code == Some(77) {
        return; // no namespaces here; the limit above has tested the same path
    }
    assert_eq!(outcome.code, Some(1), "{}", outcome.stderr);
    let words = ["cannot write \"full/noise.exr\"", "No space left", "free some space"];
    assert!(words.iter().all(|word| outcome.stderr.contains(word)), "{}", outcome.stderr);
    assert!(place.path("big.png").is_file());
}

#[cfg(target_os = "linux")]
fn under_shell(place: &Place, before: &[&str], script: &str, exr: &str, png: &str) -> Outcome {
    let shell = ["sh", "-c", script, "sh", QTRACER];
    let render = ["render", "ball.toml", "--engine", "cpu", "--size", "64x48"];
    let outputs = ["-o", exr, "-o", png, "--exposure", "-9"];
    let words = [before, &shell, &render, &outputs].concat();
    let mut command = Command::new(words[0]);
    command.args(&words[1..]).current_dir(place.0.path());
    command.output().map_or_else(
        |error| Outcome { code: None, stdout: String::new(), stderr: format!("{words:?}: {error}") },
        Outcome::from,
    )
}

#[test]
fn comparing_an_image_with_itself_passes_every_test() {
    let place = Place::new();
    place.render(&["-o", "a.exr", "--spp", "64"]);
    let all = ["compare", "a.exr", "a.exr", "--z-test", "--max-relmse", "0", "--json"];
    let outcome = place.succeed(&all);
    let json: serde_json::Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert_eq!(json["relative_mse"]["plain"], 0.0);
    assert_eq!(json["z_test"]["passes"], true);
    assert_eq!((&json["image"], &json["reference"]), (&"a.exr".into(), &"a.exr".into()));
    let table = place.succeed(&["compare", "a.exr", "a.exr"]).stdout;
    assert!(table.contains("relative MSE") && table.contains("z-test"), "{table}");
}

#[test]
fn seeds_agree_and_two_per_cent_more_light_does_not() {
    let place = Place::new();
    for (seed, name) in [("1", "a.exr"), ("2", "b.exr")] {
        place.render(&["--seed", seed, "-o", name, "--spp", "256", "--sampler", "independent"]);
    }
    let test = |a: &str| place.run(&["compare", a, "b.exr", "--z-test"]);
    let same = test("a.exr");
    assert_eq!(same.code, Some(0), "{}{}", same.stdout, same.stderr);
    let mut brighter = place.image("a.exr");
    brighter.rgb.iter_mut().flatten().for_each(|value| *value *= 1.02);
    write_image(&place.path("brighter.exr"), &brighter, &WriteOptions::default()).unwrap();
    let other = test("brighter.exr");
    assert_eq!(other.code, Some(1), "{}", other.stdout);
    assert!(other.stderr.contains("error: --z-test"), "{}", other.stderr);
}

#[test]
fn limits_on_the_error_decide_the_exit_code() {
    let place = Place::new();
    place.render(&["--seed", "1", "-o", "a.exr"]);
    place.render(&["--seed", "2", "-o", "b.exr"]);
    let limit = |limit: &str| place.run(&["compare", "a.exr", "b.exr", "--max-relmse", limit]);
    assert_eq!(limit("10").code, Some(0));
    let above = limit("1e-9");
    assert_eq!(above.code, Some(1));
    assert!(above.stderr.contains("--max-relmse"), "{}", above.stderr);
    let mut image = place.image("a.exr");
    image.rgb[5] = [f32::NAN; 3];
    write_image(&place.path("nan.exr"), &image, &WriteOptions::default()).unwrap();
    let nan = place.run(&["compare", "nan.exr", "b.exr", "--max-relmse", "10"]);
    assert_eq!(nan.code, Some(1), "{}", nan.stdout);
}

#[test]
fn standard_errors_are_found_in_a_file_beside_the_reference() {
    let place = Place::new();
    place.render(&["--seed", "1", "-o", "a.exr", "--spp", "64"]);
    let a = place.image("a.exr");
    let save = |name: &str, rgb: &[[f32; 3]]| {
        let image = Image::new(a.width, a.height, rgb.to_vec());
        write_image(&place.path(name), &image, &WriteOptions::default()).unwrap();
    };
    save("bare.exr", &a.rgb);
    let without = place.run(&["compare", "bare.exr", "bare.exr", "--z-test"]);
    assert_eq!(without.code, Some(2));
    assert!(without.stderr.contains("can't be made"), "{}", without.stderr);
    save("errors.exr", a.standard_error.as_ref().unwrap());
    let given = ["compare", "bare.exr", "bare.exr", "--z-test", "--stderr-of-b", "errors.exr"];
    assert!(place.succeed(&given).stderr.contains("\"errors.exr\""));
    fs::rename(place.path("errors.exr"), place.path("bare.se.exr")).unwrap();
    let found = place.succeed(&["compare", "a.exr", "bare.exr", "--z-test"]);
    assert!(found.stderr.contains("\"bare.se.exr\""), "{}", found.stderr);
}

#[test]
fn differences_are_written_as_pictures() {
    let place = Place::new();
    place.render(&["-o", "a.exr"]);
    let mut b = place.image("a.exr");
    b.rgb[0] = b.rgb[0].map(|value| 0.5 * value);
    b.rgb[1] = b.rgb[1].map(|value| 2.0 * value);
    write_image(&place.path("b.exr"), &b, &WriteOptions::default()).unwrap();
    place.succeed(&["compare", "a.exr", "b.exr", "--diff", "d.png"]);
    place.succeed(&["compare", "a.exr", "b.exr", "--diff", "d.exr"]);
    let (picture, values) = (place.image("d.png").rgb, place.image("d.exr").rgb);
    assert!(picture[0][0] > picture[0][2] && picture[1][2] > picture[1][0]);
    assert_eq!((picture[2], values[2]), ([0.0; 3], [0.0; 3]));
    assert_eq!((values[0][2], values[1][2]), (0.5, -1.0));
}

#[test]
fn images_that_cannot_be_compared_are_bad_input() {
    let place = Place::new();
    place.render(&["-o", "a.exr"]);
    place.render(&["-o", "wide.exr", "--size", "17x12"]);
    place.write("garbage.exr", [7u8; 300]);
    let refuses = |args: &[&str], words: &[&str]| {
        place.refuses(&[&["compare", "a.exr"], args].concat(), words);
    };
    refuses(&["missing.exr"], &["missing.exr", "check the name"]);
    refuses(&["garbage.exr"], &["garbage.exr", "undamaged"]);
    refuses(&["wide.exr"], &["16x12", "17x12"]);
    refuses(&["."], &["regular file"]);
    refuses(&["a.exr", "--stderr-of-b", "wide.exr"], &["wide.exr", "17x12"]);
    refuses(&["a.exr", "--diff", "nowhere/d.png"], &["nowhere", "does not exist"]);
    refuses(&["a.exr", "--alpha", "1"], &["--alpha", "between 0 and 1"]);
    refuses(&["a.exr", "--epsilon", "0"], &["--epsilon", "above 0"]);
    refuses(&["a.exr", "--max-relmse", "nan"], &["--max-relmse"]);
    refuses(&["a.exr", "--max-relmse", "-1"], &["--max-relmse"]);
}

#[test]
fn parts_merge_into_what_one_render_gives() {
    let place = Place::new();
    place.render(&["--spp", "64", "-o", "whole.exr"]);
    place.render(&["--spp", "31", "-o", "a.exr"]);
    place.render(&["--spp", "1", "--first-sample", "31", "-o", "b.exr"]);
    place.render(&["--spp", "32", "--first-sample", "32", "-o", "c.exr"]);
    place.succeed(&["merge", "c.exr", "a.exr", "-o", "ac.exr"]);
    place.succeed(&["merge", "ac.exr", "b.exr", "-o", "merged.exr"]);
    let (whole, merged) = (place.image("whole.exr"), place.image("merged.exr"));
    let close = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        for (a, b) in a.iter().flatten().zip(b.iter().flatten()) {
            assert!((a - b).abs() <= 1e-6 * a.abs().max(1e-3), "{a} {b}");
        }
    };
    close(&whole.rgb, &merged.rgb);
    close(&whole.standard_error.unwrap(), &merged.standard_error.unwrap());
    assert_eq!((whole.samples, whole.features), (merged.samples, merged.features));
    for key in ["scene", "seed", "first_sample", "samples", "engine", "max_bounces"] {
        assert_eq!(whole.metadata.get(key), merged.metadata.get(key), "{key}");
    }
    assert_eq!(merged.metadata.get("parts"), None);
}

#[test]
fn renders_of_different_seeds_merge_and_remember_their_parts() {
    let place = Place::new();
    for seed in ["1", "2"] {
        place.render(&["--seed", seed, "-o", &format!("{seed}.exr")]);
    }
    place.succeed(&["merge", "1.exr", "2.exr", "-o", "both.exr"]);
    let both = place.image("both.exr");
    assert_eq!(both.metadata.get("parts"), Some("1:0..2 2:0..2"));
    assert_eq!(both.metadata.get("samples"), Some("4"));
    place.refuses(&["merge", "both.exr", "2.exr", "-o", "more.exr"], &["seed 2", "share"]);
}

#[test]
fn parts_that_do_not_belong_together_are_refused() {
    let place = Place::new();
    place.variant("other.toml", "name = \"ball\"", "name = \"another\"");
    place.render(&["-o", "a.exr", "-o", "a.png"]);
    place.render(&["-o", "overlapping.exr", "--first-sample", "1"]);
    place.render(&["-o", "wide.exr", "--size", "17x12", "--seed", "1"]);
    place.render(&["-o", "short.exr", "--max-bounces", "2", "--seed", "1"]);
    place.succeed(&["render", "other.toml", "--engine", "cpu", "--seed", "1", "-o", "other.exr"]);
    let mut bare = place.image("a.exr");
    bare.samples = None;
    write_image(&place.path("bare.exr"), &bare, &WriteOptions::default()).unwrap();
    let refuses = |b: &str, words: &[&str]| {
        place.refuses(&["merge", "a.exr", b, "-o", "out.exr"], words);
    };
    refuses("a.exr", &["share samples", "--first-sample"]);
    refuses("overlapping.exr", &["share samples", "--seed"]);
    refuses("wide.exr", &["16x12", "17x12"]);
    refuses("short.exr", &["max_bounces 2", "max_bounces 64"]);
    refuses("other.exr", &["another", "ball"]);
    refuses("a.png", &["a.png", "no standard errors"]);
    refuses("bare.exr", &["bare.exr", "no sample counts"]);
    refuses("missing.exr", &["missing.exr", "check the name"]);
    place.refuses(&["merge", "a.exr", "-o", "out.exr"], &["2"]);
    place.refuses(&["merge", "a.exr", "a.exr", "-o", "no/out.exr"], &["does not exist"]);
}

#[test]
fn dumped_kernels_hold_only_what_the_scene_needs() {
    let place = Place::new();
    for (engine, kernel) in [("cpu", "step.wgsl"), ("megakernel", "megakernel.wgsl")] {
        let args = ["render", "ball.toml", "--engine", engine, "--dump-kernels", engine];
        // Without a GPU the render fails after that; the kernels are there all the same.
        no_gpu(&place, &args);
        assert!(place.path(engine).join(kernel).is_file());
    }
    let streamed = ["--schedule", "streamed", "--dump-kernels", "streamed"];
    place.render(&streamed);
    assert!(place.path("streamed/shade_diffuse.wgsl").is_file());
    for folder in ["cpu", "megakernel", "streamed"] {
        for entry in fs::read_dir(place.path(folder)).unwrap() {
            let path = entry.unwrap().path();
            assert_no_function_of_other_materials(&path);
        }
    }
}

fn assert_no_function_of_other_materials(path: &Path) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains("@compute"), "{path:?}");
    for line in text.lines().filter(|line| line.trim_start().starts_with("fn ")) {
        let foreign = ["dielectric", "glossy", "mirror"].iter().any(|kind| line.contains(kind));
        assert!(!foreign, "{path:?}: {line}");
    }
}

/// Runs as on a machine without any Vulkan driver.
fn no_gpu(place: &Place, args: &[&str]) -> Outcome {
    let mut command = place.command(args);
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        command.env(variable, "/nonexistent/driver.json");
    }
    command.output().unwrap().into()
}

#[cfg(target_os = "linux")]
#[test]
fn without_a_gpu_auto_takes_the_cpu_and_says_so_and_gpu_engines_fail() {
    let place = Place::new();
    let info = no_gpu(&place, &["info", "--json"]);
    let info: serde_json::Value = serde_json::from_str(&info.stdout).unwrap();
    assert_eq!(info["adapters"], serde_json::json!([]));
    assert_eq!(info["auto"]["engine"], "cpu");
    let text = no_gpu(&place, &["info"]);
    assert!(text.stdout.contains("none found") && text.code == Some(0), "{}", text.stdout);
    let auto = no_gpu(&place, &["render", "ball.toml"]);
    assert_eq!(auto.code, Some(0), "{}", auto.stderr);
    assert!(auto.stderr.contains("note: no GPU found"), "{}", auto.stderr);
    let gpu = no_gpu(&place, &["render", "ball.toml", "--engine", "wavefront", "-o", "w.png"]);
    assert_eq!(gpu.code, Some(1), "{}", gpu.stderr);
    assert!(gpu.stderr.contains("--engine cpu"), "{}", gpu.stderr);
    assert!(!place.path("w.png").exists());
}

#[test]
fn an_adapter_that_is_not_there_is_bad_input() {
    let place = Place::new();
    place.refuses(&["render", "ball.toml", "--adapter", "no such thing"], &["GPU"]);
}

#[test]
fn options_without_effect_are_named() {
    let place = Place::new();
    let idle = ["--pool", "1024", "--exposure", "1", "-o", "a.exr"];
    let stderr = place.render(&idle).stderr;
    assert!(stderr.contains("warning: --pool has no effect on the cpu engine"), "{stderr}");
    assert!(stderr.contains("warning: --exposure has no effect"), "{stderr}");
}

#[test]
fn guide_options_without_effect_are_named() {
    let place = Place::new();
    let warnings = |args: &[&str]| place.render(&[args, &["--spp", "1"]].concat()).stderr;
    let off = warnings(&[
        "--guide-cell",
        "1",
        "--guide-memory",
        "1M",
        "--roulette",
        "off",
        "--roulette-scale",
        "2",
    ]);
    for option in ["--guide-cell", "--guide-memory", "--roulette-scale"] {
        assert!(off.contains(&format!("warning: {option} has no effect")), "{option}: {off}");
    }
    let octant = warnings(&["--guide", "octant", "--guide-depth", "3", "--guide-discount", "0.5"]);
    assert!(octant.contains("--guide-depth has no effect with --guide octant"), "{octant}");
    assert!(octant.contains("goes with --guide bansal"), "{octant}");
    let all = ["--guide", "adaptive", "--guide-cell", "1", "--guide-depth", "3", "--guide-mixture", "0.7"];
    let more =
        ["--guide-alpha", "0.5", "--guide-learning", "4", "--guide-memory", "8M", "--roulette", "learnt"];
    let all = [&all[..], &more, &["--roulette-scale", "2"]].concat();
    let used = place.render(&[&all[..], &["--spp", "65"]].concat()).stderr;
    assert!(!used.contains("warning"), "{used}");
    let young = warnings(&all);
    assert!(young.contains("warning: learnt roulette is believed from 64 samples on"), "{young}");
    let nothing = warnings(&["--guide", "adaptive", "--guide-learning", "0"]);
    assert!(nothing.contains("warning: --guide-learning 0 without --load-guide"), "{nothing}");
    let layers = warnings(&["--guide", "adaptive", "--guide-layers"]);
    assert!(layers.contains("warning: --guide-layers has no effect"), "{layers}");
}

#[test]
fn roulette_has_a_name_and_is_still_switched_on_and_off() {
    let place = Place::new();
    for (value, name) in [("on", "throughput"), ("true", "throughput"), ("off", "off"), ("false", "off")] {
        place.render(&["--roulette", value, "-o", "a.exr"]);
        assert_eq!(place.image("a.exr").metadata.get("roulette"), Some(name), "{value}");
    }
    place.render(&["--roulette", "learnt", "--roulette-scale", "2", "-o", "a.exr"]);
    assert_eq!(place.image("a.exr").metadata.get("roulette"), Some("learnt"));
}

/// Not for few samples, nor where something is said of how paths end; and where it is not taken, the image says so.
#[test]
fn a_guide_is_tried_unasked_where_there_is_something_to_be_learnt() {
    let place = Place::new();
    let scene = BALL.replace("[render]", "[render]\nroulette = false");
    fs::write(place.path("firm.toml"), scene).unwrap();
    let tried = |args: &[&str]| {
        let outcome = place.succeed(&[&["render"], args, &["-q", "--stats", "json", "-o", "a.exr"]].concat());
        let stats: serde_json::Value = serde_json::from_str(&outcome.stdout).unwrap();
        stats.get("guide").is_some()
    };
    assert!(tried(&["ball.toml", "--spp", "256"]) && tried(&["ball.toml", "--time", "10ms"]));
    let image = place.image("a.exr").metadata;
    assert_eq!((image.get("guide"), image.get("roulette")), (Some("off"), Some("throughput")), "10 ms");
    for args in [
        &["ball.toml", "--spp", "255"][..],
        &["ball.toml", "--spp", "256", "--guide", "off"],
        &["ball.toml", "--spp", "256", "--roulette", "throughput"],
        &["ball.toml", "--spp", "256", "--roulette-scale", "2"],
        &["firm.toml", "--spp", "256"],
    ] {
        assert!(!tried(args), "{args:?}");
    }
    // Where there is no room for one, none is tried; who asks for one is told.
    let small = ["render", "ball.toml", "--spp", "256", "--guide-memory", "1K", "-o", "a.exr"];
    let outcome = place.succeed(&small);
    assert!(outcome.stderr.contains("no guide is tried: guiding would need"), "{}", outcome.stderr);
    place.refuses(&[&small[..], &["--guide", "auto"]].concat(), &["guiding would need"]);
    // By the samples to come nothing is learnt in a scene that is noisy enough to begin with.
    let room = format!("{}/scenes/bansal-room-5.toml", env!("CARGO_MANIFEST_DIR"));
    let lessons = |size: &str, spp: &str| {
        let render = ["render", &room, "--size", size, "--engine", "cpu", "-q", "--stats", "json"];
        let stdout = place.succeed(&[&render[..], &["-o", "a.exr", "--spp", spp]].concat()).stdout;
        serde_json::from_str::<serde_json::Value>(&stdout).unwrap()["guide"]["learning_samples"].as_u64()
    };
    assert_eq!(lessons("48x36", "256"), Some(0));
    assert!(lessons("16x12", "4096") > Some(0));
    let outcome =
        place.succeed(&["render", "firm.toml", "--spp", "64", "--guide", "adaptive", "-q", "-o", "a.exr"]);
    assert_eq!(outcome.code, Some(0));
    assert_eq!(place.image("a.exr").metadata.get("guide"), Some("adaptive"));
}

#[test]
fn figures_tell_what_was_learnt_and_only_then() {
    let place = Place::new();
    let stats = |args: &[&str]| -> serde_json::Value {
        let outcome = place.render(&[args, &["--spp", "8", "--stats", "json"]].concat());
        serde_json::from_str(&outcome.stdout).unwrap()
    };
    assert_eq!(stats(&[]).get("guide"), None);
    for (args, mode) in [
        (&["--guide", "adaptive"][..], "adaptive"),
        (&["--guide", "octant", "--guide-cell", "0.5"], "octant"),
        (&["--guide", "bansal-reweighted"], "bansal-reweighted"),
        (&["--roulette", "learnt"], "adaptive"),
    ] {
        let guide = &stats(args)["guide"];
        assert_eq!(guide["mode"], mode);
        assert_eq!((&guide["passes"], &guide["learning_samples"]), (&2.into(), &8.into()), "{mode}");
        assert!(guide["nodes"] == 0 || args[1] == "adaptive", "{args:?}");
        for figure in ["cells", "table_bytes", "sums_bytes"] {
            assert!(guide[figure].as_u64().unwrap() > 0, "{args:?}: {figure}");
        }
    }
    let limited = stats(&["--guide", "octant", "--guide-learning", "2"]);
    assert_eq!(limited["guide"]["learning_samples"], 4, "whole passes");
}

#[test]
fn bansals_own_rule_is_called_biased_and_not_merged_with_the_truth() {
    let place = Place::new();
    let render = |args: &[&str], seed: &str, name: &str| {
        place.render(&[args, &["--spp", "4", "--seed", seed, "-o", name]].concat()).stderr
    };
    let stderr = render(&["--guide", "bansal"], "1", "bansal.exr");
    assert!(stderr.contains("warning: --guide bansal is biased"), "{stderr}");
    render(&["--guide", "bansal"], "2", "bansal2.exr");
    render(&["--guide", "bansal", "--guide-threshold", "0.5"], "3", "other.exr");
    let quiet = render(&["--guide", "bansal-reweighted"], "4", "reweighted.exr");
    assert!(!quiet.contains("biased"), "{quiet}");
    render(&["--guide", "adaptive", "--roulette", "learnt", "--roulette-scale", "2"], "5", "adaptive.exr");
    render(&["--roulette", "off"], "6", "plain.exr");
    assert_eq!(place.image("bansal.exr").metadata.get("guide"), Some("bansal (biased)"));
    assert_eq!(place.image("adaptive.exr").metadata.get("guide"), Some("adaptive"));
    for other in ["reweighted.exr", "adaptive.exr", "plain.exr", "other.exr"] {
        for pair in [["bansal.exr", other], [other, "bansal.exr"]] {
            let args = ["merge", pair[0], pair[1], "-o", "out.exr"];
            place.refuses(&args, &[other, "bansal.exr", "bansal (biased)", "own kind"]);
        }
    }
    place.succeed(&["merge", "bansal.exr", "bansal2.exr", "-o", "both.exr"]);
    place.refuses(&["merge", "both.exr", "plain.exr", "-o", "out.exr"], &["bansal (biased)"]);
    place.succeed(&["merge", "plain.exr", "adaptive.exr", "reweighted.exr", "-o", "all.exr"]);
    let all = place.image("all.exr").metadata;
    assert_eq!(all.get("guide"), Some("off, adaptive, bansal-reweighted"));
    assert_eq!(all.get("samples"), Some("12"));
}

#[test]
fn what_was_learnt_is_kept_and_used_again() {
    let place = Place::new();
    for guide in ["bansal-reweighted", "octant", "adaptive"] {
        let learn = ["--guide", guide, "--spp", "8", "-o", "learnt.exr", "--save-guide"];
        let stderr = place.render(&[&learn[..], &["a.guide"]].concat()).stderr;
        assert!(stderr.contains("learnt.exr, a.guide"), "{stderr}");
        place.render(&[&learn[..], &["b.guide"]].concat());
        assert!(place.bytes("a.guide") == place.bytes("b.guide"), "{guide}");

        let again = ["--guide", guide, "--spp", "4", "--seed", "9", "--load-guide", "a.guide"];
        let render = |more: &[&str], name: &str| {
            let outcome = place.render(&[&again[..], more, &["-o", name, "--stats", "json"]].concat());
            assert!(!outcome.stderr.contains("warning"), "{}", outcome.stderr);
            serde_json::from_str::<serde_json::Value>(&outcome.stdout).unwrap()["guide"].clone()
        };
        let goes_on = render(&[], "goes-on.exr");
        assert_eq!((&goes_on["passes"], &goes_on["learning_samples"]), (&3.into(), &12.into()), "{guide}");
        render(&[], "goes-on-2.exr");
        assert_eq!(place.image("goes-on.exr").rgb, place.image("goes-on-2.exr").rgb, "{guide}");
        let fixed = ["--guide-learning", "0", "--save-guide", "fixed.guide"];
        assert_eq!(render(&fixed, "fixed.exr")["passes"], 2, "{guide}");
        assert!(place.bytes("a.guide") == place.bytes("fixed.guide"), "{guide} changed");
        place.render(&["--guide", guide, "--spp", "4", "--seed", "9", "-o", "anew.exr"]);
        assert_ne!(place.image("goes-on.exr").rgb, place.image("anew.exr").rgb, "{guide}");
    }
    let early = place.render(&["--guide", "octant", "--spp", "1", "--save-guide", "early.guide"]).stderr;
    assert!(early.contains("warning: \"early.guide\" knows nothing"), "{early}");
}

#[test]
fn guides_of_other_scenes_are_used_with_a_warning() {
    let place = Place::new();
    place.variant("red.toml", "color = [0.7, 0.4, 0.3]", "color = [0.9, 0.1, 0.1]");
    place.variant("aside.toml", "origin = [0, 1, 5]", "origin = [2, 1, 5]");
    place.render(&["--guide", "adaptive", "--spp", "4", "--save-guide", "a.guide"]);
    let stderr = |scene: &str| {
        let args = ["render", scene, "--engine", "cpu", "--guide", "adaptive", "--load-guide", "a.guide"];
        place.succeed(&args).stderr
    };
    assert!(stderr("red.toml").contains("warning: --load-guide: it was learnt in another scene"));
    assert!(!stderr("aside.toml").contains("warning"), "the same scene from elsewhere");
    let cell = place.render(&["--guide", "adaptive", "--load-guide", "a.guide", "--guide-cell", "1"]).stderr;
    assert!(cell.contains("warning: --guide-cell has no effect: a loaded guide"), "{cell}");
}

#[test]
fn guides_that_cannot_be_used_are_refused_by_name() {
    let place = Place::new();
    place.render(&["--guide", "octant", "--spp", "4", "--save-guide", "good.guide"]);
    let good = place.bytes("good.guide");
    let refuses = |name: &str, words: &[&str]| {
        let args = ["render", "ball.toml", "--engine", "cpu", "--guide", "octant", "--load-guide", name];
        place.refuses(&args, &[&[name], words].concat());
    };
    place.write("cut.guide", &good[..good.len() / 2]);
    refuses("cut.guide", &["cut short", "--save-guide"]);
    let mut flipped = good.clone();
    flipped[good.len() / 2] ^= 1;
    place.write("flipped.guide", flipped);
    refuses("flipped.guide", &["checksum", "--save-guide"]);
    let mut newer = good.clone();
    newer[8] = 77;
    place.write("newer.guide", newer);
    refuses("newer.guide", &["version 77", "newer qtracer"]);
    refuses("ball.toml", &["no file of what a guide has learnt"]);
    refuses("missing.guide", &["check the name"]);
    refuses(".", &["regular file"]);
    let load = |guide: &str| {
        ["render", "ball.toml", "--guide", guide, "--load-guide", "good.guide"].map(str::to_string)
    };
    for guide in ["adaptive", "bansal"] {
        let args = load(guide);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let outcome = place.run(&args);
        assert_eq!(outcome.code, Some(2), "{}", outcome.stderr);
        assert!(
            outcome.stderr.contains("good.guide") && outcome.stderr.contains("--guide octant"),
            "{}",
            outcome.stderr
        );
    }
    let small = ["render", "ball.toml", "--engine", "cpu", "--guide", "octant", "--load-guide", "good.guide"];
    place.refuses(&[&small[..], &["--guide-memory", "1K"]].concat(), &["1024", "--guide-memory"]);
}

#[test]
fn pictures_show_what_was_learnt() {
    let place = Place::new();
    for guide in ["bansal-reweighted", "octant", "adaptive"] {
        let mut pictures = Vec::new();
        for view in ["illumination", "direction", "cells", "entropy"] {
            let learn = ["--guide", guide, "--spp", "8", "--size", "40x30", "--show", view];
            place.render(&[&learn[..], &["-o", "a.png", "-o", "a.exr"]].concat());
            let (picture, image) = (place.image("a.png").rgb, place.image("a.exr"));
            let depth = &image.features.as_ref().unwrap().depth;
            let pixels = || picture.iter().zip(depth);
            let sky = || pixels().filter(|(_, depth)| **depth == 0.0).map(|(rgb, _)| *rgb);
            let ground = || pixels().filter(|(_, depth)| **depth > 0.0).map(|(rgb, _)| *rgb);
            assert!(sky().count() > 50 && sky().all(|rgb| rgb == [0.0; 3]), "{guide} {view}");
            let lit = ground().filter(|rgb| *rgb != [0.0; 3]).count();
            assert!(2 * lit > ground().count(), "{guide} {view}: {lit} lit");
            let below = picture[40 * 25 + 20];
            assert!(ground().any(|rgb| rgb != below), "{guide} {view} is even");
            assert!(says(&place.bytes("a.png"), &format!("show\0{view}")));
            assert!(image.rgb != picture && image.rgb[0] == [0.5, 0.7, 1.0], "the image stays");
            assert_layers(&image, depth);
            pictures.push(picture);
        }
        assert!(pictures.windows(2).all(|pair| pair[0] != pair[1]), "{guide}");
    }
    place.render(&["--guide", "adaptive", "--spp", "4", "--guide-layers", "-o", "b.exr", "-o", "b.png"]);
    assert!(place.image("b.exr").guide.is_some() && !says(&place.bytes("b.png"), "show\0"));
    place.succeed(&["compare", "b.exr", "b.exr", "--max-relmse", "0"]);
    place.render(&["--guide", "adaptive", "--spp", "4", "-o", "plain.exr"]);
    assert!(place.image("plain.exr").guide.is_none());
}

/// Whether a file holds this text.
fn says(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}

fn assert_layers(image: &Image, depth: &[f32]) {
    let layers = image.guide.as_ref().unwrap();
    assert!(layers.entropy.iter().all(|value| (0.0..=1.0).contains(value)));
    assert!(layers.illumination.iter().all(|value| value.is_finite() && *value >= 0.0));
    assert!(layers.cell.iter().zip(depth).all(|(&cell, &depth)| depth > 0.0 || cell == -1.0));
    for direction in &layers.direction {
        let square: f32 = direction.iter().map(|d| d * d).sum();
        assert!(square == 0.0 || (square - 1.0).abs() < 1e-3, "{direction:?}");
    }
}

#[test]
fn every_help_teaches_by_example() {
    let place = Place::new();
    for command in ["", "render", "compare", "merge", "info", "check"] {
        let args: Vec<&str> = [command, "--help"].into_iter().filter(|a| !a.is_empty()).collect();
        let help = place.succeed(&args).stdout;
        let examples = help.split_once("Examples:").expect("no examples").1;
        let lines = examples.lines().filter(|line| line.contains("qtracer ")).count();
        assert!(lines >= 3, "{command}: {lines} examples");
    }
}

#[test]
fn a_reader_that_goes_away_is_no_panic() {
    let place = Place::new();
    for args in [&["check", "ball.toml"][..], &["render", "--help"], &["info", "--json"]] {
        let mut command = place.command(args);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let outcome = Outcome::from(child.wait_with_output().unwrap());
        assert_eq!(outcome.code, Some(0), "{args:?}: {}", outcome.stderr);
        assert!(!outcome.stderr.contains("panicked"), "{}", outcome.stderr);
    }
}
