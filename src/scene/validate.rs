//! The rules a scene keeps, the same for files and for code. Each check returns what is wrong; callers name the object.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use glam::DVec3;

use super::error::{Fault, quoted};
use super::texture::{check_size, check_sum};
use super::{
    Camera, Defaults, EnvironmentMap, Geometry, Material, MaterialKind, Mesh, MeshInstance, Placement, Scene,
    SceneError, Shape, Texture,
};

/// `Err` says what is wrong and the remedy, without the object's name.
type Check = Result<(), String>;

/// Sines below this count as parallel: f32 kernels can't tell such directions apart.
const PARALLEL: f64 = 1e-6;
const LONGEST_SIDE: u64 = 65_536;
const MOST_PIXELS: u128 = 1 << 28;
/// Film and EXR output of one pixel, as measured at 4096 × 4096.
const BYTES_PER_PIXEL: u128 = 170;
/// Coordinates and sizes beyond which squares, volumes and areas would overflow an f32.
const LARGEST: f64 = 1e9;
/// Sizes below which areas would vanish in f32.
const SMALLEST: f64 = 1e-12;
/// Radiance whose sums of squares still fit into f32.
const BRIGHTEST: f64 = 1e15;
const MOST_BOUNCES: u32 = 64;
const LARGEST_EXPONENT: f64 = 1e6;
const LARGEST_IOR: f64 = 10.0;
/// Shapes that can be numbered beside instances, with room for instances that are laid out since they are few.
const MOST_LAID_OUT: u64 = (1 << 30) - (1 << 20);
/// Triangles of a model, or of all, that are laid out where few that are read become many: some gigabytes.
pub(crate) const MOST_TRIANGLES: u64 = 1 << 25;
/// Triangles that can be told apart when each instance is counted: numbers of shapes, with room for other shapes.
pub(super) const MOST_SEEN: u64 = u32::MAX as u64 - (1 << 24);

impl Scene {
    /// Checks every rule; loading and building have done so already, so this is for scenes changed since.
    ///
    /// # Errors
    /// The first rule broken, with the object and the remedy.
    pub fn validate(&self) -> Result<(), SceneError> {
        let named =
            |object: &str, check: Check| check.map_err(|problem| Fault::from(problem).of(object, None));
        named("camera", camera(&self.camera))?;
        named("environment", light("radiance", self.environment))?;
        named(
            "environment",
            self.environment_map.iter().try_for_each(|m| environment_map(m, self.environment)),
        )?;
        named("render", defaults(&self.defaults))?;
        let mut names = HashSet::new();
        for item in &self.materials {
            let object = material_label(&item.name);
            named(&object, material(item))?;
            named(&object, unique(names.insert(&item.name)))?;
        }
        for (index, item) in self.textures.iter().enumerate() {
            named(&format!("textures[{index}] {}", quoted(&item.name)), texture(item))?;
        }
        named("scene", check_sum(&self.textures))?;
        for item in &self.materials {
            named(&material_label(&item.name), textures_exist(item, self.textures.len()))?;
        }
        for (index, shape) in self.shapes.iter().enumerate() {
            let object = shape_label(index, shape.name.as_deref());
            named(&object, geometry(&shape.geometry))?;
            named(&object, material_exists(shape, self.materials.len()))?;
            named(&object, takes_textures(shape, &self.materials[shape.material]))?;
            named(&object, shared_is_dark(shape, &self.materials[shape.material]))?;
        }
        named("scene", triangles(self))?;
        Ok(())
    }
}

impl Scene {
    /// How many triangles are seen, those of a mesh counted at each of its places.
    pub fn triangle_count(&self) -> u64 {
        let count = |shape: &Shape| shape.geometry.mesh().map_or(0, |mesh| mesh.len() as u64);
        self.shapes.iter().map(count).sum()
    }
}

/// Accepts an image size for rendering, as from `--size`.
///
/// # Errors
/// Zero sides, sides above 65536, and images above 2²⁸ pixels, with the bytes those would need.
pub fn check_image_size(width: u64, height: u64) -> Result<(u32, u32), SceneError> {
    let refuse = |problem| Err(SceneError::ImageSize { width, height, problem });
    let pixels = u128::from(width) * u128::from(height);
    if pixels > MOST_PIXELS && width.max(height) <= u64::from(u32::MAX) {
        let gib = (pixels * BYTES_PER_PIXEL) as f64 / f64::powi(2.0, 30);
        return refuse(format!(
            "would need {} bytes ({gib:.1} GiB) at {BYTES_PER_PIXEL} a pixel; stay within {MOST_PIXELS} pixels, e.g. 16384 × 16384",
            pixels * BYTES_PER_PIXEL
        ));
    }
    if let Err(problem) = side_lengths(width, height) {
        return refuse(problem);
    }
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) => Ok((width, height)),
        _ => refuse("is too large".to_owned()),
    }
}

/// How messages call a material.
pub(super) fn material_label(name: &str) -> String {
    format!("material {}", quoted(name))
}

/// How messages call a shape: by its place in the list, from 0, and its name if any.
pub(super) fn shape_label(index: usize, name: Option<&str>) -> String {
    match name {
        Some(name) => format!("shapes[{index}] {}", quoted(name)),
        None => format!("shapes[{index}]"),
    }
}

pub(super) fn unique(is_new: bool) -> Check {
    ensure(is_new, || "is defined twice; rename one".into())
}

pub(super) fn camera(camera: &Camera) -> Check {
    position("origin", camera.origin)?;
    position("target", camera.target)?;
    finite_vec("up", camera.up)?;
    finite("fov_y_deg", camera.fov_y_deg)?;
    check_image_size(camera.width.into(), camera.height.into()).map_err(|e| e.to_string())?;
    let fov = camera.fov_y_deg;
    ensure(fov as f32 > 0.0 && (fov as f32) < 180.0, || {
        format!(
            "fov_y_deg {fov} is not between 0 and 180; give the full vertical angle in degrees, such as 40"
        )
    })?;
    let view = (camera.target.as_vec3() - camera.origin.as_vec3()).as_dvec3();
    finite_vec("the distance from origin to target", view)?;
    ensure(view.length() > 0.0, || {
        "origin and target are the same point; move the target to what should be seen".into()
    })?;
    ensure(camera.up.as_vec3() != glam::Vec3::ZERO, || {
        "up is zero; give a direction such as [0, 1, 0]".into()
    })?;
    ensure(!parallel(view, camera.up), || {
        "up is parallel to the view; choose another up, such as [0, 0, 1]".into()
    })
}

pub(super) fn defaults(defaults: &Defaults) -> Check {
    ensure(defaults.spp >= 1, || "spp is 0; take at least 1 sample per pixel".into())?;
    let bounces = defaults.max_bounces;
    ensure((1..=MOST_BOUNCES).contains(&bounces), || {
        format!("max_bounces {bounces} is out of range; use 1 to {MOST_BOUNCES}")
    })
}

pub(super) fn material(material: &Material) -> Check {
    ensure(!material.name.is_empty(), || "has no name; give it one that shapes can refer to".into())?;
    light("emission", material.emission)?;
    finite("normal_scale", material.textures.normal_scale)?;
    ensure(material.textures.metallic_roughness.is_none() || has_roughness(&material.kind), || {
        "metallic_roughness_texture is for materials of type \"metallic-roughness\"; remove it".into()
    })?;
    match material.kind {
        MaterialKind::Diffuse { color } => light("color", color),
        MaterialKind::Mirror { color, level } => {
            light("color", color)?;
            finite("level", level)?;
            ensure((0.0..=1.0).contains(&level), || {
                format!("level {level} is not within 0 to 1; it is the chance of perfect reflection")
            })
        }
        MaterialKind::Glossy { color, exponent } => {
            light("color", color)?;
            finite("exponent", exponent)?;
            ensure((0.0..=LARGEST_EXPONENT).contains(&exponent), || {
                format!(
                    "exponent {exponent} is not within 0 to 1e6; use 0 for the widest lobe, a mirror beyond 1e6"
                )
            })
        }
        MaterialKind::Dielectric { tint, ior } => {
            light("tint", tint)?;
            refractive_index(ior)
        }
        MaterialKind::Metal { color, roughness } => {
            light("color", color)?;
            share("roughness", roughness, "0 is smooth, 1 the roughest")
        }
        MaterialKind::MetallicRoughness { color, metallic, roughness } => {
            light("color", color)?;
            share("metallic", metallic, "0 is plastic, 1 is metal")?;
            share("roughness", roughness, "0 is smooth, 1 the roughest")
        }
        MaterialKind::RoughDielectric { tint, ior, roughness } => {
            light("tint", tint)?;
            refractive_index(ior)?;
            share("roughness", roughness, "0 is smooth, 1 the roughest")
        }
    }
}

fn share(key: &str, number: f64, meaning: &str) -> Check {
    finite(key, number)?;
    ensure((0.0..=1.0).contains(&number), || format!("{key} {number} is not within 0 to 1; {meaning}"))
}

/// Whether a texture may say how rough and how metallic the kind is.
fn has_roughness(kind: &MaterialKind) -> bool {
    matches!(kind, MaterialKind::MetallicRoughness { .. })
}

fn texture(texture: &Texture) -> Check {
    check_size(texture.width, texture.height)?;
    let needed = 4 * texture.width as usize * texture.height as usize;
    ensure(texture.rgba.len() == needed, || {
        format!("has {} bytes of texels; give it {needed}, 4 for each", texture.rgba.len())
    })
}

fn textures_exist(material: &Material, count: usize) -> Check {
    let missing = material.textures.each().find(|(_, texture)| texture.texture >= count);
    match missing {
        None => Ok(()),
        Some((key, texture)) => {
            Err(format!("{key} has index {}, out of range; there are {count} textures", texture.texture))
        }
    }
}

/// Whether the shape has the coordinates that the textures of its material need.
fn takes_textures(shape: &Shape, material: &Material) -> Check {
    let label = material_label(&material.name);
    match &shape.geometry {
        _ if !material.textures.any() => Ok(()),
        Geometry::Quad { .. } => Ok(()),
        Geometry::Sphere { .. } => Err(format!("{label} has textures, which spheres can't take; use a mesh")),
        Geometry::Mesh(mesh) => with_coordinates(mesh, &label),
        Geometry::Instance(instance) => with_coordinates(instance.mesh(), &label),
    }
}

fn with_coordinates(mesh: &Mesh, label: &str) -> Check {
    ensure(mesh.has_uvs(), || {
        format!(
            "{label} has textures, but the mesh no texture coordinates; write it with them, or use another material"
        )
    })
}

/// Whether there are numbers for all triangles, and for all that is laid out.
fn triangles(scene: &Scene) -> Check {
    let mut places = HashMap::new();
    for shape in &scene.shapes {
        if let Geometry::Instance(instance) = &shape.geometry {
            *places.entry(Arc::as_ptr(instance.mesh())).or_insert(0) += 1;
        }
    }
    // A mesh in one place spares nothing by being shared.
    let alone = |instance: &MeshInstance| places[&Arc::as_ptr(instance.mesh())] == 1;
    let numbers = |shape: &Shape| match &shape.geometry {
        Geometry::Mesh(mesh) => mesh.len() as u64,
        Geometry::Instance(instance) if alone(instance) => instance.mesh().len() as u64,
        _ => 1,
    };
    let laid_out: u64 = scene.shapes.iter().map(numbers).sum();
    ensure(laid_out <= MOST_LAID_OUT, || {
        format!("has {laid_out} shapes, each triangle counted; stay within {MOST_LAID_OUT}")
    })?;
    let seen = scene.triangle_count();
    ensure(seen <= MOST_SEEN, || {
        format!("has {seen} triangles, each instance counted; stay within {MOST_SEEN}, with fewer instances")
    })
}

/// A lamp is a triangle with a place of its own.
fn shared_is_dark(shape: &Shape, material: &Material) -> Check {
    let instance = matches!(shape.geometry, Geometry::Instance(_));
    ensure(!(instance && material.is_emissive()), || {
        format!("{} emits, which instances can't; make it a mesh of its own", material_label(&material.name))
    })
}

fn refractive_index(ior: f64) -> Check {
    finite("ior", ior)?;
    ensure(ior > 0.0, || format!("ior {ior} must be positive; glass has 1.5, water 1.33"))?;
    ensure(ior >= 1.0, || format!("ior {ior} is below 1; swap interior and exterior"))?;
    ensure(ior <= LARGEST_IOR, || format!("ior {ior} is above 10; glass has 1.5, diamond 2.4"))
}

/// Checks position, extent and shape; the material is not its affair.
pub(super) fn geometry(geometry: &Geometry) -> Check {
    match *geometry {
        Geometry::Sphere { center, radius, .. } => sphere(center, radius),
        Geometry::Quad { corner, e1, e2 } => quad(corner, e1, e2),
        // Checked when it was made.
        Geometry::Mesh(_) | Geometry::Instance(_) => Ok(()),
    }
}

/// The rules for where a mesh stands.
pub(super) fn placement(placement: &Placement) -> Check {
    let Placement { scale, rotate_y_deg, translate } = *placement;
    finite("scale", scale)?;
    finite("rotate_y_deg", rotate_y_deg)?;
    position("translate", translate)?;
    ensure(scale > 0.0, || format!("scale {scale} must be positive; turn the mesh with rotate_y_deg"))
}

/// The rules for a box, before it becomes quads.
pub(super) fn boxed(center: DVec3, size: DVec3, rotate_y_deg: f64) -> Check {
    finite_vec("center", center)?;
    finite_vec("size", size)?;
    finite("rotate_y_deg", rotate_y_deg)?;
    ensure(size.as_vec3().min_element() > 0.0, || {
        format!("size {} must be positive on every axis; use a quad for something flat", list(size))
    })?;
    let reach = DVec3::splat(size.length());
    finite_vec("center + size", center + reach).and_then(|()| finite_vec("center - size", center - reach))
}

fn sphere(center: DVec3, radius: f64) -> Check {
    position("center", center)?;
    finite("radius", radius)?;
    ensure(radius != 0.0, || "radius is 0; give a positive radius or remove the sphere".into())?;
    ensure(radius > 0.0, || {
        format!("radius {radius} is negative; use inward = true to turn a sphere inside out")
    })?;
    ensure(radius <= LARGEST, || format!("radius {radius:e} is above {LARGEST:e}; scale the scene down"))?;
    ensure(radius >= SMALLEST, || format!("radius {radius:e} is below {SMALLEST:e}; scale the scene up"))
}

fn quad(corner: DVec3, e1: DVec3, e2: DVec3) -> Check {
    position("corner", corner)?;
    for (key, edge) in [("e1", e1), ("e2", e2)] {
        position(key, edge)?;
        ensure(edge.as_vec3() != glam::Vec3::ZERO, || {
            format!("edge {key} is zero; give the vector along that side")
        })?;
        ensure(edge.length() >= SMALLEST, || {
            format!("edge {key} {} is shorter than {SMALLEST:e}; scale the scene up", list(edge))
        })?;
    }
    ensure(!parallel(e1, e2), || {
        format!("edges {} and {} are parallel, so it has no area; turn one of them", list(e1), list(e2))
    })
}

fn material_exists(shape: &Shape, count: usize) -> Check {
    let index = shape.material;
    ensure(index < count, || format!("material index {index} is out of range; there are {count} materials"))
}

fn side_lengths(width: u64, height: u64) -> Check {
    ensure(width > 0 && height > 0, || "has no pixels; make width and height 1 or more".into())?;
    ensure(width.max(height) <= LONGEST_SIDE, || {
        format!("is too large; keep each side within {LONGEST_SIDE}")
    })
}

/// Colours, radiance: finite and nowhere negative.
pub(super) fn light(key: &str, color: DVec3) -> Check {
    finite_vec(key, color)?;
    ensure(color.min_element() >= 0.0, || {
        format!("{key} {} is negative; light can't be, use 0 or more", list(color))
    })?;
    ensure(color.max_element() <= BRIGHTEST, || {
        format!("{key} {} is too bright to be squared in 32 bits; stay within {BRIGHTEST:e}", list(color))
    })
}

/// A map, with what it is multiplied by.
pub(super) fn environment_map(map: &EnvironmentMap, tint: DVec3) -> Check {
    finite("rotate_y_deg", map.rotate_y_deg())?;
    let brightest = f64::from(map.brightest()) * tint.max_element();
    ensure(brightest <= BRIGHTEST, || {
        format!(
            "map reaches a radiance of {brightest:e}, too bright to be squared in 32 bits; stay within {BRIGHTEST:e}"
        )
    })
}

/// A place or an extent: finite, and small enough that its square fits into an f32 with room to spare.
fn position(key: &str, vector: DVec3) -> Check {
    finite_vec(key, vector)?;
    ensure(vector.abs().max_element() <= LARGEST, || {
        format!("{key} {} has a coordinate beyond ±{LARGEST:e}; scale the scene down", list(vector))
    })
}

fn finite_vec(key: &str, vector: DVec3) -> Check {
    vector.to_array().into_iter().try_for_each(|number| finite(key, number))
}

fn finite(key: &str, number: f64) -> Check {
    ensure(!number.is_nan(), || format!("{key} is not a number (nan); write a finite one"))?;
    ensure(number.is_finite(), || format!("{key} is infinite; write a finite number"))?;
    ensure((number as f32).is_finite(), || {
        format!(
            "{key} {number:e} is too large for a 32-bit float; stay within ±3.4e38, or scale the scene down"
        )
    })
}

fn parallel(a: DVec3, b: DVec3) -> bool {
    let (a, b) = (a / a.abs().max_element(), b / b.abs().max_element());
    a.cross(b).length() <= PARALLEL * a.length() * b.length()
}

fn list(v: DVec3) -> String {
    format!("[{}, {}, {}]", v.x, v.y, v.z)
}

fn ensure(holds: bool, problem: impl FnOnce() -> String) -> Check {
    if holds { Ok(()) } else { Err(problem()) }
}
