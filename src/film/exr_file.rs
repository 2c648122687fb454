//! OpenEXR: linear f32, lossless (ZIP, 16 rows a block), one part.
//! Channels: R G B; stderr.R/G/B; samples; albedo.R/G/B; normal.X/Y/Z; depth.Z; guide.illumination, guide.direction.X/Y/Z,
//! guide.cell, guide.entropy. Metadata: the text attribute `qtracer`, JSON `[["scene","cornell-box"],["seed","0"],…]`.

use std::collections::HashMap;
use std::io::{Cursor, Seek, Write};

use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Blocks, Compression, Encoding, FlatSamples, Layer,
    LayerAttributes, LineOrder, ReadChannels, ReadLayers, SmallVec, Text, WritableImage,
};

use super::write::EncodeError;
use super::{Features, GuideLayers, Image, Metadata};

/// Holds our metadata.
const ATTRIBUTE: &str = "qtracer";

type Channels = AnyChannels<FlatSamples>;

pub(super) fn encode(out: &mut (impl Write + Seek), image: &Image) -> Result<(), EncodeError> {
    let attributes = LayerAttributes { other: to_attributes(&image.metadata), ..LayerAttributes::default() };
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let size = (image.width as usize, image.height as usize);
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(to_channels(image)));
    let written = exr::prelude::Image::from_layer(layer).write().to_buffered(out);
    written.map_err(|error| match error {
        exr::error::Error::Io(error) => EncodeError::Io(error),
        other => EncodeError::Format(other.to_string()),
    })
}

fn to_channels(image: &Image) -> SmallVec<[AnyChannel<FlatSamples>; 4]> {
    let mut list = SmallVec::new();
    let mut add_three = |names: [&str; 3], values: &[[f32; 3]]| {
        for (i, name) in names.into_iter().enumerate() {
            let channel = values.iter().map(|v| v[i]).collect();
            list.push(AnyChannel::new(name, FlatSamples::F32(channel)));
        }
    };
    add_three(["R", "G", "B"], &image.rgb);
    if let Some(errors) = &image.standard_error {
        add_three(["stderr.R", "stderr.G", "stderr.B"], errors);
    }
    if let Some(features) = &image.features {
        add_three(["albedo.R", "albedo.G", "albedo.B"], &features.albedo);
        add_three(["normal.X", "normal.Y", "normal.Z"], &features.normal);
    }
    if let Some(guide) = &image.guide {
        add_three(["guide.direction.X", "guide.direction.Y", "guide.direction.Z"], &guide.direction);
    }
    let (features, guide) = (image.features.as_ref(), image.guide.as_ref());
    let singles = [
        ("depth.Z", features.map(|f| &f.depth)),
        ("guide.illumination", guide.map(|g| &g.illumination)),
        ("guide.cell", guide.map(|g| &g.cell)),
        ("guide.entropy", guide.map(|g| &g.entropy)),
        ("samples", image.samples.as_ref()),
    ];
    for (name, values) in singles {
        list.extend(values.map(|values| AnyChannel::new(name, FlatSamples::F32(values.clone()))));
    }
    list
}

/// UTF-8, which OpenEXR allows in texts; the crate's own constructor would refuse what is not Latin-1.
fn text(value: &str) -> Text {
    Text::from_slice_unchecked(value.as_bytes())
}

/// One attribute for all: the crate writes several in random order, and equal images should be equal bytes.
fn to_attributes(metadata: &Metadata) -> HashMap<Text, AttributeValue> {
    let pairs: Vec<(&str, &str)> = metadata.iter().collect();
    match serde_json::to_string(&pairs) {
        Ok(json) if !pairs.is_empty() => {
            HashMap::from([(text(ATTRIBUTE), AttributeValue::Text(text(&json)))])
        }
        _ => HashMap::new(),
    }
}

/// Ours in their order, then those of other programs by name.
fn to_metadata<'a>(attributes: impl Iterator<Item = (&'a Text, &'a AttributeValue)>) -> Metadata {
    let string = |text: &Text| String::from_utf8_lossy(text.as_slice()).into_owned();
    let mut texts: Vec<(String, String)> = attributes
        .filter_map(|(key, value)| match value {
            AttributeValue::Text(value) => Some((string(key), string(value))),
            _ => None,
        })
        .collect();
    texts.sort();
    let ours = |(key, value): &(String, String)| match key == ATTRIBUTE {
        true => serde_json::from_str::<Vec<(String, String)>>(value).ok(),
        false => None,
    };
    let pairs = texts.iter().filter_map(ours).flatten();
    let others = texts.iter().filter(|text| ours(text).is_none()).cloned();
    let mut metadata = Metadata::new();
    pairs.chain(others).for_each(|(key, value)| metadata.set(&key, value));
    metadata
}

/// Why a file is no image for us.
pub(super) enum DecodeError {
    Damaged(String),
    TooLarge(usize, usize),
    NoColour(String),
}

impl From<exr::error::Error> for DecodeError {
    fn from(error: exr::error::Error) -> Self {
        DecodeError::Damaged(error.to_string())
    }
}

/// Reads R, G, B of the first part that has them (`LAYER.R` … if none is plain), and our other channels if there.
/// `allowed` is asked with (width, height, channels so far) of each part before anything of that size is allocated.
pub(super) fn decode(
    bytes: &[u8],
    allowed: impl Fn(usize, usize, usize) -> bool,
) -> Result<Image, DecodeError> {
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false)?;
    let mut channels = 0;
    for header in &meta.headers {
        let (width, height) = (header.layer_size.0, header.layer_size.1);
        channels += header.channels.list.len();
        if !allowed(width, height, channels) {
            return Err(DecodeError::TooLarge(width, height));
        }
    }
    let read = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes();
    let file = read.non_parallel().from_buffered(Cursor::new(bytes))?;
    let coloured =
        file.layer_data.iter().find_map(|layer| Some((layer, colour_prefix(&layer.channel_data)?)));
    let Some((layer, prefix)) = coloured else {
        let names =
            file.layer_data.iter().flat_map(|layer| &layer.channel_data.list).map(|c| c.name.to_string());
        return Err(DecodeError::NoColour(names.take(20).collect::<Vec<_>>().join(" ")));
    };
    let attributes = file.attributes.other.iter().chain(layer.attributes.other.iter());
    let mut image = from_channels(&layer.channel_data, &prefix, layer.size.0, layer.size.1)
        .ok_or_else(|| DecodeError::Damaged("its channels differ in size".to_string()))?;
    image.metadata = to_metadata(attributes);
    Ok(image)
}

/// "" for R, G, B; "LAYER." for the first layer that has them.
fn colour_prefix(channels: &Channels) -> Option<String> {
    let has = |name: &str| channels.list.iter().any(|channel| channel.name.eq(name));
    let complete = |prefix: &&str| ["R", "G", "B"].iter().all(|c| has(&format!("{prefix}{c}")));
    let names: Vec<String> = channels.list.iter().map(|channel| channel.name.to_string()).collect();
    let layers =
        names.iter().filter_map(|name| name.strip_suffix('R')).filter(|prefix| prefix.ends_with('.'));
    std::iter::once("").chain(layers).find(complete).map(str::to_string)
}

fn from_channels(channels: &Channels, prefix: &str, width: usize, height: usize) -> Option<Image> {
    let one = |name: &str| -> Option<Vec<f32>> {
        let channel = channels.list.iter().find(|channel| channel.name.eq(name))?;
        let plain =
            channel.sampling.0 == 1 && channel.sampling.1 == 1 && channel.sample_data.len() == width * height;
        plain.then(|| channel.sample_data.values_as_f32().collect())
    };
    let three = |prefix: &str, names: [&str; 3]| -> Option<Vec<[f32; 3]>> {
        let [x, y, z] = names.map(|name| one(&format!("{prefix}{name}")));
        Some(x?.into_iter().zip(y?).zip(z?).map(|((x, y), z)| [x, y, z]).collect())
    };
    let colours = ["R", "G", "B"];
    let features = || {
        let (albedo, normal) = (three("albedo.", colours)?, three("normal.", ["X", "Y", "Z"])?);
        Some(Features { albedo, normal, depth: one("depth.Z")? })
    };
    let guide = || {
        let direction = three("guide.direction.", ["X", "Y", "Z"])?;
        let (illumination, cell) = (one("guide.illumination")?, one("guide.cell")?);
        Some(GuideLayers { illumination, direction, cell, entropy: one("guide.entropy")? })
    };
    let mut image = Image::new(width.try_into().ok()?, height.try_into().ok()?, three(prefix, colours)?);
    image.standard_error = three("stderr.", colours);
    image.samples = one("samples");
    image.features = features();
    image.guide = guide();
    Some(image)
}
