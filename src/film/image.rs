//! A finished image: colours, and what is known about them.

use super::Metadata;
use crate::stats::ImageView;

/// First-hit features per pixel, averaged over samples: what denoisers want.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// Linear RGB.
    pub albedo: Vec<[f32; 3]>,
    /// World space.
    pub normal: Vec<[f32; 3]>,
    /// Distance from the camera in world units.
    pub depth: Vec<f32>,
}

/// What was learnt about the surface seen through each pixel. All of it is 0 where nothing was learnt.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GuideLayers {
    /// Mean radiance that arrives, weighted by the cosine: irradiance over π, but for what direct light accounts for.
    pub illumination: Vec<f32>,
    /// Mean direction from where it arrives, of length 1; world space.
    pub direction: Vec<[f32; 3]>,
    /// Number of the cell at the middle of the pixel, −1 where there is none.
    pub cell: Vec<f32>,
    /// Solid angle that the light effectively comes from, as a share of the hemisphere: 1 from everywhere alike, near 0 from
    /// one direction.
    pub entropy: Vec<f32>,
}

/// Linear RGB (Rec. 709 primaries), row 0 at the top. Every list has width × height items.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Image {
    pub width: u32,
    pub height: u32,
    pub rgb: Vec<[f32; 3]>,
    /// Of the mean, per channel.
    pub standard_error: Option<Vec<[f32; 3]>>,
    /// Per pixel.
    pub samples: Option<Vec<f32>>,
    pub features: Option<Features>,
    pub guide: Option<GuideLayers>,
    pub metadata: Metadata,
}

impl Image {
    /// An image of colours alone.
    pub fn new(width: u32, height: u32, rgb: Vec<[f32; 3]>) -> Self {
        Self { width, height, rgb, ..Self::default() }
    }

    pub fn pixel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// For [`crate::stats`].
    pub fn view(&self) -> ImageView<'_> {
        ImageView {
            width: self.width as usize,
            height: self.height as usize,
            rgb: &self.rgb,
            standard_error: self.standard_error.as_deref(),
        }
    }

    /// Name of a list that has not one item per pixel, if any; "pixels" where there are none.
    pub(super) fn malformed(&self) -> Option<&'static str> {
        let features = self.features.as_ref();
        let guide = self.guide.as_ref();
        let lists = [
            ("rgb", Some(self.rgb.len())),
            ("standard_error", self.standard_error.as_ref().map(Vec::len)),
            ("samples", self.samples.as_ref().map(Vec::len)),
            ("albedo", features.map(|f| f.albedo.len())),
            ("normal", features.map(|f| f.normal.len())),
            ("depth", features.map(|f| f.depth.len())),
            ("guide.illumination", guide.map(|g| g.illumination.len())),
            ("guide.direction", guide.map(|g| g.direction.len())),
            ("guide.cell", guide.map(|g| g.cell.len())),
            ("guide.entropy", guide.map(|g| g.entropy.len())),
        ];
        let count = self.pixel_count();
        let wrong = lists.iter().find(|(_, len)| len.is_some_and(|len| len != count));
        if count == 0 { Some("pixels") } else { wrong.map(|(name, _)| *name) }
    }
}
