//! PLY files by `ply-rs-bw`, which is met in this file only.

use std::io::BufRead;

use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

use super::MeshData;

/// Reads a mesh of at most `length` bytes. `Err` says what is wrong and the remedy.
pub(super) fn read(source: impl BufRead, length: u64) -> Result<MeshData, String> {
    let mut source = Reader::new(source);
    let header = Parser::<Skipped>::new().read_header(&mut source).map_err(malformed)?;
    fits(&header, length)?;
    let mut data = MeshData::default();
    for (name, element) in &header.elements {
        match name.as_str() {
            "vertex" => {
                if !["x", "y", "z"].iter().all(|axis| element.properties.contains_key(*axis)) {
                    return Err("has vertices without x, y and z; write it with all three".to_owned());
                }
                vertices(&mut data, &mut source, element, &header)?;
            }
            "face" => in_parts(&mut source, element, &header, |faces: Vec<Face>| {
                data.triangles.extend(faces.iter().flat_map(|face| fan(&face.corners)));
            })?,
            _ => in_parts(&mut source, element, &header, drop::<Vec<Skipped>>)?,
        }
    }
    Ok(data)
}

fn vertices(
    data: &mut MeshData,
    source: &mut Reader<impl BufRead>,
    element: &ElementDef,
    header: &Header,
) -> Result<(), String> {
    let has_all = |names: &[&str]| names.iter().all(|name| element.properties.contains_key(*name));
    let has_normals = has_all(&["nx", "ny", "nz"]);
    let has_uvs = UV_NAMES.iter().any(|pair| has_all(pair));
    in_parts(source, element, header, |part: Vec<Vertex>| {
        data.positions.extend(part.iter().map(|vertex| vertex.position));
        if has_normals {
            data.normals.extend(part.iter().map(|vertex| vertex.normal));
        }
        if has_uvs {
            // Upwards from the lower edge of the image, as is usual in files of this format.
            data.uvs.extend(part.iter().map(|vertex| [vertex.uv[0], 1.0 - vertex.uv[1]]));
        }
    })
}

/// Elements that are read at once: what the parser makes of them takes many times their bytes in the file.
const PART: usize = 1 << 14;

/// Reads all elements of a kind, some at a time.
fn in_parts<E: PropertyAccess>(
    source: &mut Reader<impl BufRead>,
    element: &ElementDef,
    header: &Header,
    mut take: impl FnMut(Vec<E>),
) -> Result<(), String> {
    let parser = Parser::new();
    let mut part = element.clone();
    let mut left = element.count;
    while left > 0 {
        part.count = left.min(PART);
        take(parser.read_payload_for_element(source, &part, header).map_err(malformed)?);
        left -= part.count;
    }
    Ok(())
}

fn malformed(error: ParseError) -> String {
    let words = error.to_string();
    let brief: String = words.lines().next().unwrap_or_default().chars().take(120).collect();
    format!("is not a whole PLY file ({brief}); write it anew")
}

/// What programs call texture coordinates.
const UV_NAMES: [[&str; 2]; 3] = [["u", "v"], ["s", "t"], ["texture_u", "texture_v"]];

#[derive(Default)]
struct Vertex {
    position: DVec3,
    normal: DVec3,
    uv: [f32; 2],
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        if let Some(axis) = UV_NAMES.iter().find_map(|names| names.iter().position(|known| *known == name)) {
            let Some(value) = number(&value) else { return PropertyAccessResult::UnsupportedType };
            self.uv[axis] = value as f32;
            return PropertyAccessResult::Set;
        }
        let place = match name {
            "x" => &mut self.position.x,
            "y" => &mut self.position.y,
            "z" => &mut self.position.z,
            "nx" => &mut self.normal.x,
            "ny" => &mut self.normal.y,
            "nz" => &mut self.normal.z,
            _ => return PropertyAccessResult::Ignored,
        };
        let Some(value) = number(&value) else { return PropertyAccessResult::UnsupportedType };
        *place = value;
        PropertyAccessResult::Set
    }
}

fn number(value: &Property) -> Option<f64> {
    Some(match *value {
        Property::Char(v) => v.into(),
        Property::UChar(v) => v.into(),
        Property::Short(v) => v.into(),
        Property::UShort(v) => v.into(),
        Property::Int(v) => v.into(),
        Property::UInt(v) => v.into(),
        Property::Float(v) => v.into(),
        Property::Double(v) => v,
        _ => return None,
    })
}

#[derive(Default)]
struct Face {
    corners: Vec<u32>,
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        if !["vertex_indices", "vertex_index"].contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.corners = match value {
            Property::ListChar(list) => numbers(list),
            Property::ListUChar(list) => numbers(list),
            Property::ListShort(list) => numbers(list),
            Property::ListUShort(list) => numbers(list),
            Property::ListInt(list) => numbers(list),
            Property::ListUInt(list) => list,
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

/// Numbers of corners. A negative one becomes one that no mesh has.
fn numbers<T: TryInto<u32>>(list: Vec<T>) -> Vec<u32> {
    list.into_iter().map(|number| number.try_into().unwrap_or(u32::MAX)).collect()
}

/// An element of which nothing is wanted.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Skipped
    }
}

/// The triangles of a face, which is taken for convex.
fn fan(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> + '_ {
    corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]])
}

/// Refuses headers that promise more than the file can hold: what is read then is bounded by the length of the file.
fn fits(header: &Header, length: u64) -> Result<(), String> {
    let needs = |element: &ElementDef| -> u128 {
        let bytes: u128 = match header.encoding {
            // A character and a blank or the end of the line, for each value.
            Encoding::Ascii => 2 * element.properties.len() as u128,
            _ => element.properties.iter().map(|(_, property)| least_bytes(&property.data_type)).sum(),
        };
        element.count as u128 * bytes
    };
    let elements = || header.elements.iter().map(|(_, element)| element);
    if elements().any(|element| element.count > 0 && element.properties.is_empty()) {
        return Err("has elements without properties; write it anew".to_owned());
    }
    let needed: u128 = elements().map(needs).sum();
    // The last line may lack its end.
    if needed > u128::from(length) + 1 {
        return Err(format!(
            "promises {needed} bytes in its header and has {length}; it is cut short or damaged, write it anew"
        ));
    }
    Ok(())
}

/// Bytes that a property takes in a binary file at least: a list may be empty.
fn least_bytes(property: &PropertyType) -> u128 {
    let (PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) = property;
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}
