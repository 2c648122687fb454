//! The keys of a scene file and what they mean: a tree in, a validated [`Scene`] out.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::boxes::box_quads;
use super::document::{Node, Value};
use super::environment;
use super::error::{Fault, SceneError, quoted, suggestion};
use super::fields::Fields;
use super::model::PlacedModels;
use super::texture::{MaterialTextures, TextureFiles, TextureRef, Wrap};
use super::validate::{self, material_label, shape_label};
use super::{Camera, Defaults, EnvironmentMap, Geometry, Material, MaterialKind, Placement, Scene, Shape};

const TOP_KEYS: [&str; 7] = ["name", "description", "camera", "environment", "render", "materials", "shapes"];
const MATERIAL_TYPES: [&str; 7] =
    ["diffuse", "mirror", "glossy", "dielectric", "metal", "metallic-roughness", "rough-dielectric"];
const SHAPE_TYPES: [&str; 4] = ["sphere", "quad", "box", "mesh"];

/// Names of materials and their places in [`Scene::materials`].
pub(super) type MaterialNames = BTreeMap<String, usize>;

/// Reads and validates a whole document, meshes from the folder in which it lies.
pub(super) fn scene(root: &Node, folder: Option<&Path>) -> Result<Scene, SceneError> {
    let top = Fields::of(root).map_err(|fault| fault.of("scene", root.line))?;
    let (name, description) = heading(&top).map_err(|fault| fault.of("scene", root.line))?;
    let mut files = TextureFiles::new(folder);
    let mut materials = materials(top.node("materials"), &mut files)?;
    let names =
        materials.iter().enumerate().map(|(index, material)| (material.name.clone(), index)).collect();
    let mut models = PlacedModels::new(folder, &mut materials, &mut files.all);
    let shapes = shapes(top.node("shapes"), &names, &mut models)?;
    let file_warnings = models.warnings();
    let (radiance, environment_map) =
        section(&top, "environment", |fields| environment(fields, folder))?.unwrap_or_default();
    let scene = Scene {
        name,
        description,
        camera: section(&top, "camera", camera)?.ok_or_else(no_camera)?,
        environment: radiance,
        environment_map,
        shapes,
        defaults: section(&top, "render", render)?.unwrap_or_default(),
        materials,
        file_warnings,
        textures: files.all,
    };
    scene.validate()?;
    Ok(scene)
}

/// Reads one optional top-level table, naming it in errors.
fn section<T>(
    top: &Fields<'_>,
    key: &str,
    read: impl FnOnce(&Fields<'_>) -> Result<T, Fault>,
) -> Result<Option<T>, SceneError> {
    let Some(node) = top.node(key) else {
        return Ok(None);
    };
    let value =
        Fields::of(node).and_then(|fields| read(&fields)).map_err(|fault| fault.of(key, node.line))?;
    Ok(Some(value))
}

fn heading(top: &Fields<'_>) -> Result<(String, String), Fault> {
    top.only(&TOP_KEYS)?;
    Ok((top.need("name")?, top.get("description")?.unwrap_or_default()))
}

fn no_camera() -> SceneError {
    let problem = "is missing; add a [camera] with origin, target, fov_y_deg, width and height";
    Fault::from(problem.to_owned()).of("camera", None)
}

fn camera(fields: &Fields<'_>) -> Result<Camera, Fault> {
    fields.only(&["origin", "target", "up", "fov_y_deg", "width", "height"])?;
    let camera = Camera {
        origin: fields.need("origin")?,
        target: fields.need("target")?,
        up: fields.get("up")?.unwrap_or(DVec3::Y),
        fov_y_deg: fields.need("fov_y_deg")?,
        width: fields.need("width")?,
        height: fields.need("height")?,
    };
    validate::camera(&camera).map_err(|problem| fields.broken(problem))?;
    Ok(camera)
}

/// A radiance, or a map and what it is multiplied by.
fn environment(fields: &Fields<'_>, folder: Option<&Path>) -> Result<(DVec3, Option<EnvironmentMap>), Fault> {
    let Some(file) = fields.get::<String>("map")? else {
        if let Some(key) = ["scale", "rotate_y_deg"].into_iter().find(|key| fields.node(key).is_some()) {
            return Err(fields.broken(format!("{key} needs a map; add map = \"sky.hdr\" or remove it")));
        }
        fields.only(&["radiance", "map", "scale", "rotate_y_deg"])?;
        let radiance = fields.need("radiance")?;
        validate::light("radiance", radiance).map_err(|problem| fields.broken(problem))?;
        return Ok((radiance, None));
    };
    fields.only(&["radiance", "map", "scale", "rotate_y_deg"])?;
    let tint = fields.get("radiance")?.unwrap_or(DVec3::ONE);
    let scale = fields.get("scale")?.unwrap_or(1.0);
    validate::light("radiance", tint).map_err(|problem| fields.broken(problem))?;
    validate::light("scale", DVec3::splat(scale)).map_err(|problem| fields.broken(problem))?;
    let map = environment::of_scene(&file, folder).map_err(|problem| fields.broken(problem))?;
    let map = map.rotated(fields.get("rotate_y_deg")?.unwrap_or(0.0));
    validate::environment_map(&map, tint * scale).map_err(|problem| fields.broken(problem))?;
    Ok((tint * scale, Some(map)))
}

fn render(fields: &Fields<'_>) -> Result<Defaults, Fault> {
    fields.only(&["spp", "max_bounces", "direct_light", "roulette"])?;
    let usual = Defaults::default();
    let defaults = Defaults {
        spp: fields.get("spp")?.unwrap_or(usual.spp),
        max_bounces: fields.get("max_bounces")?.unwrap_or(usual.max_bounces),
        direct_light: fields.get("direct_light")?.unwrap_or(usual.direct_light),
        roulette: fields.get("roulette")?.unwrap_or(usual.roulette),
    };
    validate::defaults(&defaults).map_err(|problem| fields.broken(problem))?;
    Ok(defaults)
}

fn materials(node: Option<&Node>, files: &mut TextureFiles<'_>) -> Result<Vec<Material>, SceneError> {
    let Some(node) = node else {
        return Ok(Vec::new());
    };
    let Value::Table(table) = &node.value else {
        let problem = format!("must be tables such as [materials.white], not {}", node.describe());
        return Err(Fault::from(problem).of("materials", node.line));
    };
    let read = |(name, node): (&String, &Node)| {
        material(name, node, files).map_err(|fault| fault.of(&material_label(name), node.line))
    };
    table.iter().map(read).collect()
}

fn material(name: &str, node: &Node, files: &mut TextureFiles<'_>) -> Result<Material, Fault> {
    let fields = Fields::of(node)?;
    let kind = material_kind(&fields)?;
    let textures = textures(&fields, files)?;
    // A texture that shines does so without a factor beside it.
    let usual = if textures.emission.is_some() { DVec3::ONE } else { DVec3::ZERO };
    let emission = fields.get("emission")?.unwrap_or(usual);
    let material = Material { name: name.to_owned(), kind, emission, textures };
    validate::material(&material).map_err(|problem| fields.broken(problem))?;
    Ok(material)
}

/// Keys that every material may have.
const TEXTURE_KEYS: [&str; 6] = [
    "color_texture",
    "metallic_roughness_texture",
    "emission_texture",
    "normal_texture",
    "normal_scale",
    "texture_wrap",
];

/// Refuses keys that are neither `own` nor those of every material.
fn only_of_material(fields: &Fields<'_>, own: &[&str]) -> Result<(), Fault> {
    fields.only(&[own, &["type", "emission"], &TEXTURE_KEYS].concat())
}

/// The colour, which may be left to the texture.
fn color(fields: &Fields<'_>) -> Result<DVec3, Fault> {
    match fields.node("color_texture") {
        Some(_) => Ok(fields.get("color")?.unwrap_or(DVec3::ONE)),
        None => fields.need("color"),
    }
}

fn textures(fields: &Fields<'_>, files: &mut TextureFiles<'_>) -> Result<MaterialTextures, Fault> {
    let line = |key: &str| fields.node(key).and_then(|node| node.line);
    let wrap = match fields.get::<String>("texture_wrap")?.as_deref() {
        None | Some("repeat") => Wrap::Repeat,
        Some("clamp") => Wrap::Clamp,
        Some("mirror") => Wrap::Mirror,
        Some(other) => {
            let hint = suggestion(other, ["repeat", "clamp", "mirror"]);
            let problem = format!("unknown texture_wrap {}{hint}", quoted(other));
            return Err(Fault::new(line("texture_wrap"), problem));
        }
    };
    let mut texture = |key: &str| -> Result<Option<TextureRef>, Fault> {
        let Some(name) = fields.get::<String>(key)? else { return Ok(None) };
        let number =
            files.number(&name).map_err(|problem| Fault::new(line(key), format!("{key}: {problem}")))?;
        Ok(Some(TextureRef { texture: number, wrap_u: wrap, wrap_v: wrap }))
    };
    Ok(MaterialTextures {
        color: texture("color_texture")?,
        metallic_roughness: texture("metallic_roughness_texture")?,
        emission: texture("emission_texture")?,
        normal: texture("normal_texture")?,
        normal_scale: fields.get("normal_scale")?.unwrap_or(1.0),
    })
}

fn material_kind(fields: &Fields<'_>) -> Result<MaterialKind, Fault> {
    let kind: String = fields.need("type")?;
    match kind.as_str() {
        "diffuse" => {
            only_of_material(fields, &["color"])?;
            Ok(MaterialKind::Diffuse { color: color(fields)? })
        }
        "mirror" => {
            only_of_material(fields, &["color", "level"])?;
            Ok(MaterialKind::Mirror { color: color(fields)?, level: fields.get("level")?.unwrap_or(1.0) })
        }
        "glossy" => {
            only_of_material(fields, &["color", "exponent"])?;
            Ok(MaterialKind::Glossy { color: color(fields)?, exponent: fields.need("exponent")? })
        }
        "dielectric" => {
            only_of_material(fields, &["tint", "ior"])?;
            Ok(MaterialKind::Dielectric {
                tint: fields.get("tint")?.unwrap_or(DVec3::ONE),
                ior: fields.need("ior")?,
            })
        }
        "metal" => {
            only_of_material(fields, &["color", "roughness"])?;
            Ok(MaterialKind::Metal { color: color(fields)?, roughness: fields.need("roughness")? })
        }
        "metallic-roughness" => {
            only_of_material(fields, &["color", "metallic", "roughness"])?;
            Ok(MaterialKind::MetallicRoughness {
                color: color(fields)?,
                metallic: fields.need("metallic")?,
                roughness: fields.need("roughness")?,
            })
        }
        "rough-dielectric" => {
            only_of_material(fields, &["tint", "ior", "roughness"])?;
            Ok(MaterialKind::RoughDielectric {
                tint: fields.get("tint")?.unwrap_or(DVec3::ONE),
                ior: fields.need("ior")?,
                roughness: fields.need("roughness")?,
            })
        }
        other => Err(unknown_type(fields, other, &MATERIAL_TYPES)),
    }
}

fn shapes(
    node: Option<&Node>,
    names: &MaterialNames,
    models: &mut PlacedModels<'_>,
) -> Result<Vec<Shape>, SceneError> {
    let Some(node) = node else {
        return Ok(Vec::new());
    };
    let Value::List(list) = &node.value else {
        let problem = format!("must be a list of [[shapes]], not {}", node.describe());
        return Err(Fault::from(problem).of("shapes", node.line));
    };
    for (file, smooth) in list.iter().filter_map(placed_file) {
        models.announce(file, smooth);
    }
    let mut shapes = Vec::with_capacity(list.len());
    for (index, node) in list.iter().enumerate() {
        let sides = shape(node, names, models)
            .map_err(|fault| fault.of(&shape_label(index, shape_name(node)), node.line))?;
        shapes.extend(sides);
    }
    Ok(shapes)
}

/// The name of a shape that may be otherwise invalid.
fn shape_name(node: &Node) -> Option<&str> {
    match &entry(node, "name")?.value {
        Value::Text(name) => Some(name),
        _ => None,
    }
}

/// The file that a shape places, and whether with its normals; the shape may be otherwise invalid.
fn placed_file(node: &Node) -> Option<(&str, bool)> {
    let smooth = entry(node, "smooth").is_none_or(|smooth| !matches!(smooth.value, Value::Flag(false)));
    match &entry(node, "file")?.value {
        Value::Text(file) => Some((file, smooth)),
        _ => None,
    }
}

fn entry<'a>(node: &'a Node, key: &str) -> Option<&'a Node> {
    match &node.value {
        Value::Table(table) => table.get(key),
        _ => None,
    }
}

fn shape(node: &Node, names: &MaterialNames, models: &mut PlacedModels<'_>) -> Result<Vec<Shape>, Fault> {
    let fields = Fields::of(node)?;
    let kind: String = fields.need("type")?;
    if kind == "mesh" {
        return meshed(&fields, names, models);
    }
    let sides = geometry(&fields, &kind)?;
    let name: Option<String> = fields.get("name")?;
    let material = own_material(&fields, names)?;
    Ok(sides.into_iter().map(|geometry| Shape { name: name.clone(), material, geometry }).collect())
}

fn own_material(fields: &Fields<'_>, names: &MaterialNames) -> Result<usize, Fault> {
    let wanted: String = fields.need("material")?;
    let line = fields.node("material").and_then(|node| node.line);
    material_index(&wanted, names).map_err(|problem| Fault::new(line, problem))
}

fn geometry(fields: &Fields<'_>, kind: &str) -> Result<Vec<Geometry>, Fault> {
    let geometry = match kind {
        "sphere" => {
            fields.only(&["type", "name", "material", "center", "radius", "inward"])?;
            let inward = fields.get("inward")?.unwrap_or(false);
            Geometry::Sphere { center: fields.need("center")?, radius: fields.need("radius")?, inward }
        }
        "quad" => {
            fields.only(&["type", "name", "material", "corner", "e1", "e2"])?;
            Geometry::Quad { corner: fields.need("corner")?, e1: fields.need("e1")?, e2: fields.need("e2")? }
        }
        "box" => return boxed(fields),
        other => return Err(unknown_type(fields, other, &SHAPE_TYPES)),
    };
    validate::geometry(&geometry).map_err(|problem| fields.broken(problem))?;
    Ok(vec![geometry])
}

fn boxed(fields: &Fields<'_>) -> Result<Vec<Geometry>, Fault> {
    fields.only(&["type", "name", "material", "center", "size", "rotate_y_deg"])?;
    let (center, size) = (fields.need("center")?, fields.need("size")?);
    let rotate_y_deg = fields.get("rotate_y_deg")?.unwrap_or(0.0);
    validate::boxed(center, size, rotate_y_deg).map_err(|problem| fields.broken(problem))?;
    Ok(box_quads(center, size, rotate_y_deg).to_vec())
}

fn meshed(
    fields: &Fields<'_>,
    names: &MaterialNames,
    models: &mut PlacedModels<'_>,
) -> Result<Vec<Shape>, Fault> {
    fields.only(&["type", "name", "material", "file", "scale", "rotate_y_deg", "translate", "smooth"])?;
    let usual = Placement::default();
    let placement = Placement {
        scale: fields.get("scale")?.unwrap_or(usual.scale),
        rotate_y_deg: fields.get("rotate_y_deg")?.unwrap_or(usual.rotate_y_deg),
        translate: fields.get("translate")?.unwrap_or(usual.translate),
    };
    validate::placement(&placement).map_err(|problem| fields.broken(problem))?;
    let file: String = fields.need("file")?;
    let broken = |problem| fields.broken(format!("file {} {problem}", quoted(&file)));
    let number = models.number(&file).map_err(broken)?;
    let own = fields.node("material").is_none() && models.has_materials(number);
    let material = if own { None } else { Some(own_material(fields, names)?) };
    let smooth = fields.get("smooth")?;
    if smooth == Some(true) && !models.has_normals(number) {
        let file = quoted(&file);
        let problem = format!("smooth needs normals, which file {file} does not have; write it with them");
        return Err(fields.broken(problem));
    }
    let mut shapes = models.place(number, &placement, smooth != Some(false), material).map_err(broken)?;
    let first = if own { models.first_material(number).map_err(broken)? } else { 0 };
    let name: Option<String> = fields.get("name")?;
    for shape in &mut shapes {
        shape.material = material.unwrap_or(first + shape.material);
        shape.name = name.clone().or(shape.name.take());
    }
    Ok(shapes)
}

/// The index of a material, or which name may have been meant.
pub(super) fn material_index(name: &str, names: &MaterialNames) -> Result<usize, String> {
    names.get(name).copied().ok_or_else(|| {
        format!("unknown material {}{}", quoted(name), suggestion(name, names.keys().map(String::as_str)))
    })
}

/// Words of other renderers are translated, misspellings corrected.
fn unknown_type(fields: &Fields<'_>, given: &str, known: &[&str]) -> Fault {
    let translation = match given {
        "glass" => "; use \"dielectric\"".to_owned(),
        "conductor" | "ggx" => "; use \"metal\"".to_owned(),
        "pbr" | "principled" => "; use \"metallic-roughness\"".to_owned(),
        "lambert" | "lambertian" | "matte" => "; use \"diffuse\"".to_owned(),
        "emitter" | "light" | "emissive" => "; use \"diffuse\" and give it an emission".to_owned(),
        _ => suggestion(given, known.iter().copied()),
    };
    Fault::new(
        fields.node("type").and_then(|node| node.line),
        format!("unknown type {}{translation}", quoted(given)),
    )
}
