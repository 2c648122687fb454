//! A glTF file in the making.

use qtracer::Scene;
use qtracer::scene::{Geometry, Mesh, SceneError, Shape};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

pub const U8: u32 = 5121;
pub const U16: u32 = 5123;
pub const U32: u32 = 5125;
pub const F32: u32 = 5126;

/// The corners of a cube of side 2 about the origin: bit k of the number says which end of axis k.
pub const CUBE: [[f32; 3]; 8] = [
    [-1.0, -1.0, -1.0],
    [1.0, -1.0, -1.0],
    [-1.0, 1.0, -1.0],
    [1.0, 1.0, -1.0],
    [-1.0, -1.0, 1.0],
    [1.0, -1.0, 1.0],
    [-1.0, 1.0, 1.0],
    [1.0, 1.0, 1.0],
];

/// Its sides, outwards.
pub const CUBE_SIDES: [[u32; 3]; 12] = [
    [0, 4, 6],
    [0, 6, 2],
    [1, 3, 7],
    [1, 7, 5], // x
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3], // y
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6], // z
];

/// A file with one scene, whose nodes are those that [`Gltf::stand`] adds.
#[derive(Clone)]
pub struct Gltf {
    pub json: Value,
    pub binary: Vec<u8>,
}

impl Gltf {
    pub fn new() -> Gltf {
        let json = json!({ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [] }] });
        Gltf { json, binary: Vec::new() }
    }

    /// A cube's mesh, without a node.
    pub fn cube() -> Gltf {
        let mut file = Gltf::new();
        let (positions, indices) = (file.positions(&CUBE), file.indices(&CUBE_SIDES));
        file.mesh(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
        file
    }

    /// Adds to one of the file's lists; its number there.
    pub fn add(&mut self, list: &str, value: Value) -> usize {
        let root = self.json.as_object_mut().unwrap();
        let list = root.entry(list).or_insert_with(|| json!([])).as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    /// Adds a node to the scene.
    pub fn stand(&mut self, node: Value) -> usize {
        let number = self.add("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(number));
        number
    }

    /// Adds bytes; the number of their view.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let offset = self.binary.len();
        self.binary.extend(bytes);
        self.add("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }))
    }

    pub fn accessor(&mut self, component: u32, kind: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        self.add(
            "accessors",
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }),
        )
    }

    /// Bounds of positions are required, and not used.
    pub fn positions(&mut self, corners: &[[f32; 3]]) -> usize {
        let bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(F32, "VEC3", corners.len(), &bytes)
    }

    pub fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let bytes: Vec<u8> = triangles.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(U32, "SCALAR", 3 * triangles.len(), &bytes)
    }

    /// A mesh of one primitive.
    pub fn mesh(&mut self, primitive: Value) -> usize {
        self.add("meshes", json!({ "primitives": [primitive] }))
    }

    /// Lights as KHR_lights_punctual has them, each with a node.
    pub fn light(&mut self, light: Value, mut node: Value) {
        let lights = &mut self.json["extensions"]["KHR_lights_punctual"]["lights"];
        if lights.is_null() {
            *lights = json!([]);
        }
        let lights = lights.as_array_mut().unwrap();
        node["extensions"] = json!({ "KHR_lights_punctual": { "light": lights.len() } });
        lights.push(light);
        self.stand(node);
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"].is_null() && !self.binary.is_empty() {
            json["buffers"] = json!([{ "byteLength": self.binary.len() }]);
        }
        glb(json.to_string().as_bytes(), &self.binary)
    }

    /// The file as a scene.
    pub fn load(&self) -> Result<Scene, SceneError> {
        load_bytes(&self.glb())
    }

    pub fn scene(&self) -> Scene {
        self.load().unwrap_or_else(|error| panic!("{error}"))
    }

    /// What the file is refused with.
    pub fn problem(&self) -> String {
        self.load().expect_err("refused").to_string()
    }
}

/// A .glb file of these two chunks.
pub fn glb(json: &[u8], binary: &[u8]) -> Vec<u8> {
    let chunk = |kind: &[u8; 4], bytes: &[u8], fill: u8| {
        let mut body = bytes.to_vec();
        body.resize(body.len().next_multiple_of(4), fill);
        [&(body.len() as u32).to_le_bytes()[..], kind, &body].concat()
    };
    let chunks = [chunk(b"JSON", json, b' '), chunk(b"BIN\0", binary, 0)].concat();
    let length = 12 + chunks.len() as u32;
    [&b"glTF"[..], &2u32.to_le_bytes(), &length.to_le_bytes(), &chunks].concat()
}

pub fn load_bytes(bytes: &[u8]) -> Result<Scene, SceneError> {
    let place = Place::new();
    Scene::load(place.write("model.glb", bytes))
}

/// A folder of its own.
pub struct Place(TempDir);

impl Place {
    pub fn new() -> Place {
        Place(TempDir::new().unwrap())
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

/// The meshes of a scene, in its order.
pub fn meshes(scene: &Scene) -> Vec<&Mesh> {
    fn mesh(shape: &Shape) -> Option<&Mesh> {
        match &shape.geometry {
            Geometry::Mesh(mesh) => Some(mesh),
            _ => None,
        }
    }
    scene.shapes.iter().filter_map(mesh).collect()
}

/// What is odd about a scene, in words.
pub fn warnings(scene: &Scene) -> Vec<String> {
    scene.warnings().iter().map(|warning| warning.to_string()).collect()
}

/// Whether some warning has these words.
pub fn warns(scene: &Scene, words: &str) -> bool {
    warnings(scene).iter().any(|warning| warning.contains(words))
}
