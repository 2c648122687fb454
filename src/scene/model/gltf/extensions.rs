//! Which extensions of glTF are read, which do no harm when they are not, and which are told of.

use ::gltf::json::Root;

use crate::scene::error::quoted;
use crate::scene::model::findings::Findings;

/// Read, or covered by reading every type of accessor.
const READ: [&str; 6] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
];
/// Data for people and other programs, not for pictures.
const SILENT: [&str; 2] = ["KHR_xmp_json_ld", "KHR_xmp"];
/// Names in a message.
const LONGEST_LIST: usize = 8;

/// Refuses files that need what is not read; notes what is not read of the others.
pub(super) fn check(root: &Root, findings: &mut Findings) -> Result<(), String> {
    let unknown = |names: &'_ [String]| -> Vec<String> {
        let other = |name: &&String| !READ.contains(&name.as_str()) && !SILENT.contains(&name.as_str());
        names.iter().filter(other).map(|name| quoted(name)).collect()
    };
    let required = unknown(&root.extensions_required);
    if !required.is_empty() {
        return Err(format!(
            "needs {}, which qtracer does not read; write the file without",
            listed(&required)
        ));
    }
    let used = unknown(&root.extensions_used);
    if !used.is_empty() {
        findings.note("not read, so the image may differ from other programs'", listed(&used));
    }
    Ok(())
}

fn listed(names: &[String]) -> String {
    let more = names.len().saturating_sub(LONGEST_LIST);
    let tail = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{tail}", names[..names.len() - more].join(", "))
}
