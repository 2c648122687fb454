//! Materials: glTF's metallic-roughness model and the extensions that are read, as qtracer's.

use ::gltf::json::extensions;
use ::gltf::json::material::{AlphaMode, Material as Given};
use ::gltf::json::texture::Info;
use ::gltf::json::validation::Checked;
use glam::DVec3;

use super::textures::Images;
use crate::scene::error::quoted;
use crate::scene::model::Names;
use crate::scene::model::findings::Findings;
use crate::scene::{Material, MaterialKind, MaterialTextures};

/// The materials in the order of the file, with names that differ.
pub(super) fn read(
    given: &[Given],
    names: &mut Names,
    images: &mut Images<'_>,
    findings: &mut Findings,
) -> Result<Vec<Material>, String> {
    let mut materials: Vec<Material> = Vec::with_capacity(given.len());
    for (number, given) in given.iter().enumerate() {
        let name = given
            .name
            .clone()
            .filter(|name| !name.is_empty())
            .unwrap_or_else(|| format!("material {number}"));
        let place = format!("material {}", quoted(&name));
        let (kind, emission) = (kind(given, &place, findings), emission(given, &place, findings));
        let material =
            Material { name: names.fresh(name), kind, emission, textures: MaterialTextures::default() };
        materials.push(textured(given, material, images, &place, findings)?);
        tell_of_rest(given, &place, findings);
    }
    Ok(materials)
}

/// The material of primitives that have none, named as no other is.
pub(super) fn usual(names: &mut Names) -> Material {
    let name = names.fresh("default material".to_owned());
    let kind = kind(&Given::default(), "", &mut Findings::default());
    Material { name, kind, emission: DVec3::ZERO, textures: MaterialTextures::default() }
}

/// The material with those of its textures that it has a use for.
fn textured(
    given: &Given,
    material: Material,
    images: &mut Images<'_>,
    place: &str,
    findings: &mut Findings,
) -> Result<Material, String> {
    let model = &given.pbr_metallic_roughness;
    let unlit = given.extensions.as_ref().is_some_and(|extensions| extensions.unlit.is_some());
    let mut slot = |info: Option<&Info>| match info {
        Some(info) => images.texture(info.index, info.tex_coord, place, findings),
        None => Ok(None),
    };
    let color = slot(model.base_color_texture.as_ref())?;
    let rough = slot(model.metallic_roughness_texture.as_ref())?;
    let shines = material.is_emissive() && !unlit;
    let emission = slot(given.emissive_texture.as_ref().filter(|_| shines))?;
    let normal = match &given.normal_texture {
        Some(info) => images.texture(info.index, info.tex_coord, place, findings)?,
        None => None,
    };
    let takes_rough = matches!(material.kind, MaterialKind::MetallicRoughness { .. });
    if rough.is_some() && !takes_rough && !unlit {
        findings.note("is of glass, whose roughness is even here; the texture of it is not taken", place);
    }
    let textures = MaterialTextures {
        color: color.filter(|_| !unlit),
        metallic_roughness: rough.filter(|_| takes_rough),
        emission: if unlit { color } else { emission },
        normal,
        normal_scale: given.normal_texture.as_ref().map_or(1.0, |info| f64::from(info.scale)),
    };
    Ok(material.textured(textures))
}

fn kind(given: &Given, place: &str, findings: &mut Findings) -> MaterialKind {
    let model = &given.pbr_metallic_roughness;
    let [r, g, b, _] = model.base_color_factor.0;
    let color = DVec3::from_array([r, g, b].map(|channel| share(channel, place, findings)));
    let metallic = share(model.metallic_factor.0, place, findings);
    let roughness = share(model.roughness_factor.0, place, findings);
    let extensions = given.extensions.as_ref();
    if extensions.is_some_and(|extensions| extensions.unlit.is_some()) {
        findings.note("is unlit, so it emits its color, reflects nothing and lights others", place);
        return MaterialKind::Diffuse { color: DVec3::ZERO };
    }
    let transmission = extensions.and_then(|extensions| extensions.transmission.as_ref());
    let transmitted = transmission.map_or(0.0, |found| share(found.transmission_factor.0, place, findings));
    if transmitted > 0.0 && transmitted < 1.0 {
        findings.note(
            "lets a part of the light through; it is taken as glass from a half on, else as opaque",
            place,
        );
    }
    match transmitted >= 0.5 {
        true => {
            let ior = index_of_refraction(extensions, place, findings);
            match roughness > 0.0 {
                true => MaterialKind::RoughDielectric { tint: color, ior, roughness },
                false => MaterialKind::Dielectric { tint: color, ior },
            }
        }
        false => MaterialKind::MetallicRoughness { color, metallic, roughness },
    }
}

/// KHR_materials_ior; 1.5 unless said, and 0 means that everything is reflected.
fn index_of_refraction(
    extensions: Option<&extensions::material::Material>,
    place: &str,
    findings: &mut Findings,
) -> f64 {
    const LARGEST: f64 = 10.0;
    let given =
        extensions.and_then(|extensions| extensions.ior.as_ref()).map_or(1.5, |ior| f64::from(ior.ior.0));
    let taken = if given == 0.0 { LARGEST } else { given.clamp(1.0, LARGEST) };
    if taken != given {
        findings.note("has an ior that is not within 1 to 10; it is moved there", place);
    }
    if taken.is_nan() { 1.5 } else { taken }
}

/// emissiveFactor × KHR_materials_emissive_strength, or the color of what is unlit; radiance in cd/m².
fn emission(given: &Given, place: &str, findings: &mut Findings) -> DVec3 {
    let extensions = given.extensions.as_ref();
    if extensions.is_some_and(|extensions| extensions.unlit.is_some()) {
        let [r, g, b, _] = given.pbr_metallic_roughness.base_color_factor.0;
        return DVec3::from_array([r, g, b].map(|channel| share(channel, place, findings)));
    }
    let strength = extensions.and_then(|extensions| extensions.emissive_strength.as_ref());
    let strength = strength.map_or(1.0, |strength| f64::from(strength.emissive_strength.0));
    let emission = DVec3::from_array(given.emissive_factor.0.map(f64::from)) * strength;
    let possible = emission.is_finite() && emission.min_element() >= 0.0;
    if !possible {
        findings.note("has an emission that is negative or infinite; it emits nothing", place);
    }
    if possible && emission != DVec3::ZERO && given.double_sided {
        findings.note(
            "shines on both sides in the file and only on the outer one here; turn it, or give it a back",
            place,
        );
    }
    if possible { emission } else { DVec3::ZERO }
}

/// A factor from 0 to 1.
fn share(factor: f32, place: &str, findings: &mut Findings) -> f64 {
    let taken = if factor.is_nan() { 0.0 } else { factor.clamp(0.0, 1.0) };
    if taken != factor {
        findings.note("has a factor that is not within 0 to 1; it is moved there", place);
    }
    f64::from(taken)
}

/// What has no counterpart.
fn tell_of_rest(given: &Given, place: &str, findings: &mut Findings) {
    if !matches!(given.alpha_mode, Checked::Valid(AlphaMode::Opaque)) {
        findings.note("is see-through where its alpha is low in the file, and opaque here", place);
    }
    if given.occlusion_texture.is_some() {
        findings.note("has an occlusion texture, which is not read; paths find out what is shaded", place);
    }
}
