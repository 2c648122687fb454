//! Files on disk: the shipped scenes load, and what is no scene says so.

use std::path::{Path, PathBuf};

use super::ROOM;
use crate::scene::Scene;

fn shipped() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let entries = std::fs::read_dir(folder).expect("scenes/ is there");
    let mut paths: Vec<_> = entries.map(|entry| entry.expect("readable").path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    paths
}

fn load(name: &str) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name).with_extension("toml");
    Scene::load(path).unwrap_or_else(|error| panic!("{error}"))
}

fn counts(scene: &Scene) -> (usize, usize) {
    let lights = scene.shapes.iter().filter(|shape| scene.materials[shape.material].is_emissive()).count();
    (scene.shapes.len(), lights)
}

#[test]
fn shipped_scenes_load_without_warnings_under_their_own_names() {
    let paths = shipped();
    assert!(paths.len() >= 15, "only {} scenes", paths.len());
    for path in paths {
        let scene = Scene::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(Some(scene.name.as_str()), path.file_stem().and_then(|stem| stem.to_str()));
        assert_eq!(scene.warnings(), [], "{}", scene.name);
    }
}

#[test]
fn shipped_scenes_open_with_what_a_right_render_shows() {
    for path in shipped() {
        let text = std::fs::read_to_string(&path).expect("readable");
        let opening: String = text.lines().take_while(|line| line.starts_with('#')).collect();
        assert!(opening.contains("A right render"), "{}", path.display());
    }
}

#[test]
fn shipped_scenes_have_the_stated_objects_and_lights() {
    let expected = [
        ("bansal-exp-1", 6, 1),
        ("bansal-exp-2", 9, 1),
        ("bansal-exp-3", 13, 2),
        ("bansal-room-1", 13, 3),
        ("bansal-room-5", 14, 1),
        ("cornell-box", 16, 1),
        ("door-ajar", 64, 1),
        ("furnace-open", 1, 0),
        ("furnace-closed-90", 1, 1),
        ("glass-caustic", 4, 1),
    ];
    for (name, objects, lights) in expected {
        assert_eq!(counts(&load(name)), (objects, lights), "{name}");
    }
    assert_eq!(counts(&load("many-lights")).1, 200);
}

#[test]
fn timed_experiments_are_as_timed() {
    for (name, width, height) in
        [("bansal-exp-1", 360, 240), ("bansal-exp-2", 640, 480), ("bansal-exp-3", 640, 480)]
    {
        let scene = load(name);
        let (camera, defaults) = (scene.camera, scene.defaults);
        assert_eq!(
            (camera.width, camera.height, defaults.spp, defaults.max_bounces),
            (width, height, 64, 8),
            "{name}"
        );
    }
}

#[test]
fn what_is_no_scene_file_says_so() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("writable");
        path
    };
    let message = |path: &Path| Scene::load(path).expect_err("no scene").to_string();
    let says = |path: &Path, words: &str| {
        let message = message(path);
        assert!(message.contains(words) && message.starts_with(&path.display().to_string()), "{message}");
    };
    says(&folder.path().join("missing.toml"), "no such file");
    says(folder.path(), "is a directory");
    says(&write("empty.toml", b""), "is empty");
    says(&write("garbage.toml", &[0xff, 0xfe, 0x00, 0x80]), "not UTF-8");
    says(&write("zeros.json", &[0; 100]), "not valid JSON");
    says(&write("room.yaml", ROOM.as_bytes()), ".toml or .json");
    says(&write("room", ROOM.as_bytes()), ".toml or .json");
    says(
        &write("bad.toml", ROOM.replace("0.5\nmaterial", "0\nmaterial").as_bytes()),
        ":38: shapes[1] \"lamp\": radius is 0",
    );
    assert!(Scene::load(write("ROOM.TOML", ROOM.as_bytes())).is_ok());
}

#[test]
fn huge_files_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("huge.toml");
    std::fs::File::create(&path).and_then(|file| file.set_len((64 << 20) + 1)).expect("a sparse file");
    assert!(Scene::load(&path).expect_err("huge").to_string().contains("larger than 64 MiB"));
}
