//! A way to guide and to end paths, in one word: GUIDE[:ROULETTE[:SCALE[:SPLIT]]], such as `off:throughput:4`, `adaptive:learnt:3`,
//! `adaptive:learnt:6:8` or `auto`. Parts left out are the program's defaults.

use qtracer::RenderOptions;
use qtracer::guiding::GuideMode;
use qtracer::transport::roulette::Roulette;
use std::str::FromStr;

/// What a variant is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// As it was written: what rows and legends call it.
    pub text: String,
    pub guide: GuideMode,
    /// Whether plain tracing is tried as well (`auto`).
    pub trial: bool,
    pub roulette: Option<Roulette>,
    pub scale: Option<f32>,
    /// Copies that a path may become.
    pub split: Option<u32>,
}

/// The form of a variant, for messages.
pub const FORM: &str = "GUIDE[:ROULETTE[:SCALE[:SPLIT]]], where GUIDE is off, auto, adaptive, octant, bansal or \
bansal-reweighted, ROULETTE is off, throughput or learnt, SCALE is a number above 0, and SPLIT is 1 to 8";

impl FromStr for Variant {
    type Err = String;

    fn from_str(text: &str) -> Result<Variant, String> {
        let wrong = |what: &str| format!("{what} in the variant \"{text}\"; write {FORM}");
        let mut parts = text.split(':');
        let name = parts.next().unwrap_or_default();
        let guide = guide_mode(name).ok_or_else(|| wrong(&format!("there is no guide \"{name}\"")))?;
        let roulette = parts
            .next()
            .map(|part| roulette(part).ok_or_else(|| wrong(&format!("there is no roulette \"{part}\""))))
            .transpose()?;
        let scale = parts
            .next()
            .map(|part| positive(part).ok_or_else(|| wrong(&format!("\"{part}\" is no scale"))))
            .transpose()?;
        let split = parts
            .next()
            .map(|part| part.parse().map_err(|_| wrong(&format!("\"{part}\" is no number of copies"))))
            .transpose()?;
        match parts.next() {
            Some(part) => Err(wrong(&format!("\"{part}\" is too much"))),
            None => {
                Ok(Variant { text: text.to_string(), guide, trial: name == "auto", roulette, scale, split })
            }
        }
    }
}

fn guide_mode(name: &str) -> Option<GuideMode> {
    Some(match name {
        "off" => GuideMode::Off,
        "bansal" => GuideMode::Bansal,
        "bansal-reweighted" => GuideMode::BansalReweighted,
        "octant" => GuideMode::Octant,
        "adaptive" | "auto" => GuideMode::Adaptive,
        _ => return None,
    })
}

fn roulette(name: &str) -> Option<Roulette> {
    Some(match name {
        "off" => Roulette::Off,
        "throughput" => Roulette::Throughput,
        "learnt" => Roulette::Learnt,
        _ => return None,
    })
}

fn positive(text: &str) -> Option<f32> {
    text.parse().ok().filter(|scale: &f32| scale.is_finite() && *scale > 0.0)
}

impl Variant {
    /// Asks `options` for this variant.
    pub fn apply(&self, options: &mut RenderOptions) {
        options.guide.mode = self.guide;
        options.guide.trial = self.trial;
        options.roulette = self.roulette;
        options.roulette_scale = self.scale;
        options.split = self.split;
    }
}
