//! Scenes made in code.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::boxes::box_quads;
use super::description::material_index;
use super::error::Fault;
use super::mesh::Sharing;
use super::validate::{self, shape_label};
use super::{
    Camera, Defaults, EnvironmentMap, Geometry, Material, Mesh, MeshData, Placement, Scene, SceneError,
    Shape, Texture,
};

/// Makes a [`Scene`] step by step; nothing is checked before [`build`](Self::build). Order is free, shapes may come
/// before their materials.
///
/// ```
/// use qtracer::scene::{Material, Scene};
///
/// let scene = Scene::builder("room")
///     .camera([0.0, 1.0, 4.0], [0.0, 0.0, 0.0], 40.0)
///     .size(320, 240)
///     .environment([0.1, 0.1, 0.1])
///     .material("white", Material::diffuse([0.7, 0.7, 0.7]))
///     .material("glass", Material::dielectric([1.0, 1.0, 1.0], 1.5))
///     .material("lamp", Material::diffuse([0.0; 3]).emitting([15.0, 14.0, 12.0]))
///     .quad([-3.0, 0.0, -3.0], [0.0, 0.0, 6.0], [6.0, 0.0, 0.0], "white")
///     .sphere([0.0, 1.0, 0.0], 0.5, "glass")
///     .sphere([1.0, 3.0, 0.0], 0.2, "lamp")
///     .named("the lamp")
///     .boxed([-1.0, 0.5, 0.0], [1.0, 1.0, 1.0], 30.0, "white")
///     .build()?;
/// assert_eq!(scene.shapes.len(), 3 + 6);
/// assert!(scene.warnings().is_empty());
///
/// let error = Scene::builder("oops").camera([0.0, 0.0, 1.0], [0.0; 3], 40.0)
///     .material("white", Material::diffuse([0.7; 3]))
///     .sphere([0.0; 3], 1.0, "whit")
///     .build().unwrap_err();
/// assert_eq!(error.to_string(), r#"shapes[0]: unknown material "whit"; did you mean "white"?"#);
/// # Ok::<(), qtracer::scene::SceneError>(())
/// ```
#[derive(Clone, Debug)]
#[must_use = "call build() to get the scene"]
pub struct SceneBuilder {
    /// All but the shapes.
    scene: Scene,
    has_camera: bool,
    shapes: Vec<Draft>,
}

/// A shape whose material is still a name.
#[derive(Clone, Debug)]
struct Draft {
    name: Option<String>,
    material: String,
    outline: Outline,
}

#[derive(Clone, Debug)]
enum Outline {
    Plain(Geometry),
    Box { center: DVec3, size: DVec3, rotate_y_deg: f64 },
    Mesh { data: MeshData, placement: Placement },
    Instance { data: Arc<MeshData>, map: DAffine3 },
}

impl Scene {
    /// Starts a scene of that name, with a black environment, 512 × 512 pixels, and no camera yet.
    pub fn builder(name: impl Into<String>) -> SceneBuilder {
        let (origin, target, up) = (DVec3::Z, DVec3::ZERO, DVec3::Y);
        let scene = Scene {
            name: name.into(),
            description: String::new(),
            camera: Camera { origin, target, up, fov_y_deg: 40.0, width: 512, height: 512 },
            environment: DVec3::ZERO,
            environment_map: None,
            materials: Vec::new(),
            textures: Vec::new(),
            shapes: Vec::new(),
            defaults: Defaults::default(),
            file_warnings: Vec::new(),
        };
        SceneBuilder { scene, has_camera: false, shapes: Vec::new() }
    }
}

impl SceneBuilder {
    /// What the scene shows.
    pub fn description(mut self, text: impl Into<String>) -> Self {
        self.scene.description = text.into();
        self
    }

    /// Where to look from and to, and the full vertical angle in degrees. Up is +y unless [`up`](Self::up) says else.
    pub fn camera(mut self, origin: impl Into<DVec3>, target: impl Into<DVec3>, fov_y_deg: f64) -> Self {
        let camera = &mut self.scene.camera;
        (camera.origin, camera.target, camera.fov_y_deg) = (origin.into(), target.into(), fov_y_deg);
        self.has_camera = true;
        self
    }

    /// What is up in the image.
    pub fn up(mut self, up: impl Into<DVec3>) -> Self {
        self.scene.camera.up = up.into();
        self
    }

    /// Image size in pixels, 1 to 65536 each.
    pub fn size(mut self, width: u32, height: u32) -> Self {
        (self.scene.camera.width, self.scene.camera.height) = (width, height);
        self
    }

    /// Radiance from every direction that hits nothing.
    pub fn environment(mut self, radiance: impl Into<DVec3>) -> Self {
        self.scene.environment = radiance.into();
        self
    }

    /// Radiance by direction, for what hits nothing. A radiance of the environment that is not black multiplies it.
    pub fn environment_map(mut self, map: EnvironmentMap) -> Self {
        if self.scene.environment == DVec3::ZERO {
            self.scene.environment = DVec3::ONE;
        }
        self.scene.environment_map = Some(map);
        self
    }

    /// Recommended render settings.
    pub fn render(mut self, defaults: Defaults) -> Self {
        self.scene.defaults = defaults;
        self
    }

    /// Defines a material; `name` replaces any it had.
    pub fn material(mut self, name: impl Into<String>, material: Material) -> Self {
        self.scene.materials.push(Material { name: name.into(), ..material });
        self
    }

    /// Adds an image that materials may refer to: the first has number 0.
    pub fn texture(mut self, texture: Texture) -> Self {
        self.scene.textures.push(texture);
        self
    }

    /// Adds a sphere with outward normals.
    pub fn sphere(self, center: impl Into<DVec3>, radius: f64, material: impl Into<String>) -> Self {
        let center = center.into();
        self.shape(Outline::Plain(Geometry::Sphere { center, radius, inward: false }), material)
    }

    /// Adds a sphere that emits inwards.
    pub fn inward_sphere(self, center: impl Into<DVec3>, radius: f64, material: impl Into<String>) -> Self {
        let center = center.into();
        self.shape(Outline::Plain(Geometry::Sphere { center, radius, inward: true }), material)
    }

    /// Adds a parallelogram with outward normal e1 × e2.
    pub fn quad(
        self,
        corner: impl Into<DVec3>,
        e1: impl Into<DVec3>,
        e2: impl Into<DVec3>,
        material: impl Into<String>,
    ) -> Self {
        let (corner, e1, e2) = (corner.into(), e1.into(), e2.into());
        self.shape(Outline::Plain(Geometry::Quad { corner, e1, e2 }), material)
    }

    /// Adds a box about `center`, turned about its vertical axis, as six outward quads.
    pub fn boxed(
        self,
        center: impl Into<DVec3>,
        size: impl Into<DVec3>,
        rotate_y_deg: f64,
        material: impl Into<String>,
    ) -> Self {
        let (center, size) = (center.into(), size.into());
        self.shape(Outline::Box { center, size, rotate_y_deg }, material)
    }

    /// Adds triangles as they are, with outward normals on the side from which their corners go counterclockwise.
    pub fn mesh(self, data: MeshData, material: impl Into<String>) -> Self {
        self.placed_mesh(data, Placement::default(), material)
    }

    /// Adds triangles, scaled, turned and moved.
    pub fn placed_mesh(self, data: MeshData, placement: Placement, material: impl Into<String>) -> Self {
        self.shape(Outline::Mesh { data, placement }, material)
    }

    /// Adds the same triangles in many places, each under an affine map and of a material; maps that mirror leave outer sides
    /// outside. They are stored once where that spares much ([`Instancing`](super::Instancing)), but what emits has triangles of
    /// its own, and so has what f32 can't bring to its place: maps that stretch lengths by less than 1e-6 or more than 1e6, or
    /// that undo large coordinates.
    ///
    /// ```
    /// use glam::{DAffine3, DVec3};
    /// use qtracer::scene::{Material, MeshData, Scene};
    ///
    /// let leaf = MeshData {
    ///     positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
    ///     triangles: vec![[0, 1, 2]],
    ///     ..Default::default()
    /// };
    /// let places = (0..1000).map(|i| (DAffine3::from_translation(DVec3::Z * f64::from(i)), "green"));
    /// let scene = Scene::builder("leaves")
    ///     .camera([0.0, 0.0, -5.0], [0.0; 3], 40.0)
    ///     .environment([1.0; 3])
    ///     .material("green", Material::diffuse([0.2, 0.6, 0.1]))
    ///     .mesh_in_places(leaf, places)
    ///     .build()?;
    /// assert_eq!(scene.shapes.len(), 1000);
    /// # Ok::<(), qtracer::scene::SceneError>(())
    /// ```
    pub fn mesh_in_places<M: Into<String>>(
        mut self,
        data: MeshData,
        places: impl IntoIterator<Item = (DAffine3, M)>,
    ) -> Self {
        let data = Arc::new(data);
        for (map, material) in places {
            self = self.shape(Outline::Instance { data: data.clone(), map }, material);
        }
        self
    }

    /// Names the shape added last, for messages; does nothing before the first.
    pub fn named(mut self, name: impl Into<String>) -> Self {
        if let Some(last) = self.shapes.last_mut() {
            last.name = Some(name.into());
        }
        self
    }

    /// Checks everything and makes the scene.
    ///
    /// # Errors
    /// As [`Scene::validate`], and for a missing camera or unknown material names.
    pub fn build(self) -> Result<Scene, SceneError> {
        let Self { mut scene, has_camera, shapes } = self;
        if !has_camera {
            return Err(Fault::from("is missing; call camera(origin, target, fov_y_deg)".to_owned())
                .of("camera", None));
        }
        let names = scene
            .materials
            .iter()
            .enumerate()
            .map(|(index, material)| (material.name.clone(), index))
            .collect();
        let mut shared = Shared::default();
        for (index, draft) in shapes.into_iter().enumerate() {
            let object = shape_label(index, draft.name.as_deref());
            let (material, sides) = material_index(&draft.material, &names)
                .map_err(Fault::from)
                .and_then(|material| {
                    let shines = scene.materials[material].is_emissive();
                    Ok((material, resolve(draft.outline, shines, &mut shared)?))
                })
                .map_err(|fault| fault.of(&object, None))?;
            scene.shapes.extend(sides.into_iter().map(|geometry| Shape {
                name: draft.name.clone(),
                material,
                geometry,
            }));
        }
        scene.validate()?;
        Ok(scene)
    }

    fn shape(mut self, outline: Outline, material: impl Into<String>) -> Self {
        self.shapes.push(Draft { name: None, material: material.into(), outline });
        self
    }
}

/// What is shared, by where its data lies; nothing where it had better not be. It holds on to the data, so that no other can
/// lie there.
type Shared = HashMap<*const MeshData, (Arc<MeshData>, Option<Sharing>)>;

/// The checked surfaces of an outline.
fn resolve(outline: Outline, shines: bool, shared: &mut Shared) -> Result<Vec<Geometry>, Fault> {
    let sides = match outline {
        Outline::Plain(geometry) => {
            validate::geometry(&geometry)?;
            vec![geometry]
        }
        Outline::Box { center, size, rotate_y_deg } => {
            validate::boxed(center, size, rotate_y_deg)?;
            box_quads(center, size, rotate_y_deg).to_vec()
        }
        Outline::Mesh { data, placement } => {
            validate::placement(&placement)?;
            vec![laid_out(&data.placed(&placement))?]
        }
        Outline::Instance { data, map } => vec![instance(data, &map, shines, shared)?],
    };
    Ok(sides)
}

fn laid_out(data: &MeshData) -> Result<Geometry, Fault> {
    let mesh = Mesh::new(data).map_err(|problem| format!("the mesh {problem}"))?;
    Ok(Geometry::Mesh(Arc::new(mesh)))
}

fn instance(
    data: Arc<MeshData>,
    map: &DAffine3,
    shines: bool,
    shared: &mut Shared,
) -> Result<Geometry, Fault> {
    let (_, sharing) =
        shared.entry(Arc::as_ptr(&data)).or_insert_with(|| (data.clone(), Sharing::new(&data)));
    match sharing.as_ref().filter(|_| !shines).and_then(|sharing| sharing.at(map)) {
        Some(instance) => Ok(Geometry::Instance(instance)),
        None => laid_out(&data.transformed(map)),
    }
}
