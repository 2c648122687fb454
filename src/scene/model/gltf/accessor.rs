//! Rows of numbers in buffers. Everything is checked when an accessor is opened: reading a row below `count` then can't fail, and
//! nothing is allocated.

use std::ops::Range;

use ::gltf::json::accessor::{ComponentType, Type, sparse};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Root, accessor, buffer};

use super::buffers::Buffers;

/// An accessor that was checked against its buffers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows<'a> {
    pub count: usize,
    /// Numbers in a row.
    pub width: usize,
    pub component: ComponentType,
    normalized: bool,
    /// Zeros where there are none.
    base: Option<Strided<'a>>,
    replaced: Option<Replaced<'a>>,
}

/// Elements at equal distances.
#[derive(Clone, Copy, Debug)]
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

/// Rows of a sparse accessor that differ from its base, by growing numbers.
#[derive(Clone, Copy, Debug)]
struct Replaced<'a> {
    count: usize,
    numbers: Strided<'a>,
    component: ComponentType,
    values: Strided<'a>,
}

impl<'a> Rows<'a> {
    /// `Err` says what is wrong and the remedy.
    pub fn open(
        root: &Root,
        buffers: &'a Buffers<'_>,
        index: Index<accessor::Accessor>,
    ) -> Result<Rows<'a>, String> {
        let number = index.value();
        let accessor = root
            .accessors
            .get(number)
            .ok_or_else(|| format!("names accessor {number}, which is not there"))?;
        open(root, buffers, accessor)
            .map_err(|problem| format!("has accessors[{number}], which {problem}; write it anew"))
    }

    /// The first N numbers of a row; integers are divided by their greatest where the accessor says so.
    pub fn row<const N: usize>(&self, row: usize) -> [f64; N] {
        let bytes = self.bytes(row);
        let size = self.component.size();
        std::array::from_fn(|i| match bytes.and_then(|bytes| bytes.get(i * size..(i + 1) * size)) {
            Some(bytes) => scaled(number(self.component, bytes), self.component, self.normalized),
            None => 0.0,
        })
    }

    /// A number that counts something.
    pub fn index(&self, row: usize) -> usize {
        self.bytes(row).map_or(0, |bytes| number(self.component, bytes) as usize)
    }

    fn bytes(&self, row: usize) -> Option<&'a [u8]> {
        let replacement = self.replaced.and_then(|replaced| replaced.find(row));
        replacement.or_else(|| self.base.map(|base| base.at(row)))
    }
}

fn open<'a>(
    root: &Root,
    buffers: &'a Buffers<'_>,
    accessor: &accessor::Accessor,
) -> Result<Rows<'a>, String> {
    let (Checked::Valid(component), Checked::Valid(shape)) = (accessor.component_type, accessor.type_) else {
        return Err("is of no known type".to_owned());
    };
    let component = component.0;
    if matches!(shape, Type::Mat2 | Type::Mat3 | Type::Mat4) {
        return Err("holds matrices".to_owned());
    }
    let width = shape.multiplicity();
    let size = width * component.size();
    let count = accessor.count.0;
    let base = match accessor.buffer_view {
        Some(view) => {
            let offset = accessor.byte_offset.unwrap_or_default().0;
            Some(strided(root, buffers, view, offset, count, size)?)
        }
        None => {
            let held: usize = buffers.iter().map(|buffer| buffer.len()).sum();
            if count > held as u64 {
                return Err(format!("promises {count} rows of zeros, more than the file has bytes"));
            }
            None
        }
    };
    let replaced =
        accessor.sparse.as_ref().map(|sparse| replaced(root, buffers, sparse, count, size)).transpose()?;
    Ok(Rows { count: count as usize, width, component, normalized: accessor.normalized, base, replaced })
}

/// The bytes of a view, if it lies within its buffer.
pub(super) fn view_bytes<'a>(
    root: &Root,
    buffers: &'a Buffers<'_>,
    view: Index<buffer::View>,
) -> Result<&'a [u8], String> {
    let number = view.value();
    let view = root.buffer_views.get(number).ok_or("names a view that is not there")?;
    let buffer = buffers.get(view.buffer.value()).ok_or("names a buffer that is not there")?;
    let range = span(view.byte_offset.unwrap_or_default().0, view.byte_length.0);
    let within = range.and_then(|range| buffer.get(range));
    within.ok_or_else(|| format!("lies in bufferViews[{number}], which reaches beyond its buffer"))
}

/// So many bytes from there, if they can be counted.
fn span(start: u64, length: u64) -> Option<Range<usize>> {
    Some(usize::try_from(start).ok()?..usize::try_from(start.checked_add(length)?).ok()?)
}

/// `count` elements of `size` bytes of a view, if they lie within it and it within its buffer.
fn strided<'a>(
    root: &Root,
    buffers: &'a Buffers<'_>,
    view: Index<buffer::View>,
    offset: u64,
    count: u64,
    size: usize,
) -> Result<Strided<'a>, String> {
    let number = view.value();
    let within = view_bytes(root, buffers, view)?;
    let view = root.buffer_views.get(number).ok_or("names a view that is not there")?;
    let stride = view.byte_stride.map_or(size, |stride| stride.0);
    if stride < size {
        return Err(format!("has rows of {size} bytes every {stride} bytes"));
    }
    let length = match count {
        0 => Some(0),
        _ => (count - 1).checked_mul(stride as u64).and_then(|bytes| bytes.checked_add(size as u64)),
    };
    let bytes =
        length.and_then(|length| span(offset, length)).and_then(|range| within.get(range)).ok_or_else(
            || format!("promises {count} rows of {size} bytes, more than bufferViews[{number}] holds"),
        )?;
    Ok(Strided { bytes, stride, size })
}

fn replaced<'a>(
    root: &Root,
    buffers: &'a Buffers<'_>,
    given: &sparse::Sparse,
    count: u64,
    size: usize,
) -> Result<Replaced<'a>, String> {
    let Checked::Valid(component) = given.indices.component_type else {
        return Err("has sparse indices of no known type".to_owned());
    };
    let component = component.0;
    let (indices, values, entries) = (&given.indices, &given.values, given.count.0);
    let numbers =
        strided(root, buffers, indices.buffer_view, indices.byte_offset.0, entries, component.size())?;
    let values = strided(root, buffers, values.buffer_view, values.byte_offset.0, entries, size)?;
    let found = Replaced { count: entries as usize, numbers, component, values };
    let growing = (1..found.count).all(|entry| found.number(entry - 1) < found.number(entry));
    if !growing || (found.count > 0 && found.number(found.count - 1) as u64 >= count) {
        return Err("has sparse indices that do not grow or go beyond its rows".to_owned());
    }
    Ok(found)
}

impl<'a> Strided<'a> {
    fn at(&self, element: usize) -> &'a [u8] {
        let start = element * self.stride;
        self.bytes.get(start..start + self.size).unwrap_or_default()
    }
}

impl<'a> Replaced<'a> {
    fn number(&self, entry: usize) -> usize {
        number(self.component, self.numbers.at(entry)) as usize
    }

    fn find(&self, row: usize) -> Option<&'a [u8]> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.number(middle) < row { low = middle + 1 } else { high = middle }
        }
        (low < self.count && self.number(low) == row).then(|| self.values.at(low))
    }
}

/// One number, little-endian; 0 where there are no bytes.
fn number(component: ComponentType, bytes: &[u8]) -> f64 {
    let word = || bytes.first_chunk::<4>().copied().unwrap_or_default();
    let half = || bytes.first_chunk::<2>().copied().unwrap_or_default();
    let byte = || bytes.first().copied().unwrap_or_default();
    match component {
        ComponentType::I8 => f64::from(byte() as i8),
        ComponentType::U8 => f64::from(byte()),
        ComponentType::I16 => f64::from(i16::from_le_bytes(half())),
        ComponentType::U16 => f64::from(u16::from_le_bytes(half())),
        ComponentType::U32 => f64::from(u32::from_le_bytes(word())),
        ComponentType::F32 => f64::from(f32::from_le_bytes(word())),
    }
}

/// Normalised integers as shares of the greatest (glTF 2.0, 3.6.2.2).
fn scaled(number: f64, component: ComponentType, normalized: bool) -> f64 {
    match (normalized, component) {
        (false, _) | (_, ComponentType::F32 | ComponentType::U32) => number,
        (_, ComponentType::I8) => (number / 127.0).max(-1.0),
        (_, ComponentType::U8) => number / 255.0,
        (_, ComponentType::I16) => (number / 32767.0).max(-1.0),
        (_, ComponentType::U16) => number / 65535.0,
    }
}
