//! What a caller may choose about a render.

use super::RenderError;
use crate::gpu::stage::Schedule;
use crate::guiding::{GuideMode, GuideOptions, GuideProblem, Learner};
use crate::random::Sampler;
use crate::scene::{Geometry, Instancing, MOST_TRIANGLES, Scene, check_image_size};
use crate::transport::estimators::Estimators;
use crate::transport::roulette::Roulette;
use crate::transport::split::MAX_SPLIT;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// The engines, as they can be asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum EngineChoice {
    /// A real GPU if there is one, else the CPU.
    #[default]
    Auto,
    Cpu,
    Wavefront,
    Megakernel,
}

/// The engines, as they run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EngineKind {
    Cpu,
    Wavefront,
    Megakernel,
}

impl fmt::Display for EngineKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            EngineKind::Cpu => "cpu",
            EngineKind::Wavefront => "wavefront",
            EngineKind::Megakernel => "megakernel",
        })
    }
}

/// What a render is to come to in all, as far as is known: whichever is reached first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Budget {
    /// Samples per pixel.
    pub samples: Option<u32>,
    /// Time from when the renderer is ready.
    pub time: Option<Duration>,
    /// Relative standard error, as [`Film::relative_error`](crate::Film::relative_error) defines it.
    pub error: Option<f64>,
}

impl Budget {
    /// Samples per pixel that it comes to, at `rate` samples a second and with a relative error of `error` after `samples`; `None` if it
    /// says nothing.
    pub(super) fn expected(&self, samples: u32, rate: f64, error: f64) -> Option<u32> {
        let by_time = self.time.map(|limit| rate * limit.as_secs_f64());
        let by_error = self.error.map(|limit| f64::from(samples) * (error / limit).powi(2));
        let all = [self.samples.map(f64::from), by_time, by_error];
        all.into_iter().flatten().filter(|n| !n.is_nan()).reduce(f64::min).map(|n| n as u32)
    }
}

/// Scale of learnt roulette that suits most scenes.
const LEARNT_SCALE: f32 = 4.0;

/// Options of a render; `None` means what the scene says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderOptions {
    /// Width and height in pixels.
    pub size: Option<(u32, u32)>,
    pub seed: u32,
    pub engine: EngineChoice,
    /// Part of the GPU's name.
    pub adapter: Option<String>,
    /// Next-event estimation combined with BSDF sampling.
    pub direct_light: Option<bool>,
    /// Whether scenes of many lights choose among them by a tree, as is usual, or by power alone.
    pub light_tree: Option<bool>,
    /// Whether instances of a mesh share its triangles; by memory, unless said.
    pub instances: Instancing,
    /// Russian roulette: off, by throughput from the fourth surface on, or by what was learnt.
    pub roulette: Option<Roulette>,
    /// Survival in roulette is this times what it would be, up to certainty: larger is slower and less noisy. 1 by
    /// default, for learnt roulette 4.
    pub roulette_scale: Option<f32>,
    /// Where learnt roulette expects more of a path than of others, it may go on as up to so many copies in all, 1 to 8; 1
    /// by default.
    pub split: Option<u32>,
    /// Whether and how paths are guided by what earlier ones found.
    pub guide: GuideOptions,
    /// How much will be rendered: a guide's `trial` is left out where what it costs could not be won back. It ends nothing. With a
    /// time, the same seed may decide otherwise on a machine of another speed.
    pub budget: Budget,
    /// What was learnt before, to start from; its mode must be the one asked for. It may be of another scene
    /// ([`Learner::scene`] tells): it steers paths, and the image is right all the same.
    pub guide_table: Option<Arc<Learner>>,
    /// Levels of a path, 1 to 64: 1 shows only what emits, 2 adds direct light.
    pub max_bounces: Option<u32>,
    pub sampler: Sampler,
    /// Number of the first sample of each pixel, to render a later part of the same image.
    pub first_sample: u32,
    /// How the wavefront engine runs a level; `None` is the one that measured fastest for such scenes
    /// ([`preferred_schedule`](super::preferred_schedule)).
    pub schedule: Option<Schedule>,
    /// Rays that the queues of the wavefront engine hold; `None` suits the GPU.
    pub pool: Option<u32>,
    /// Levels of a path that the fused schedule traces at once, or paths that an invocation of the megakernel traces, 1 to
    /// 64; `None` follows the lengths of paths. The image does not depend on it.
    pub grain: Option<u32>,
}

impl RenderOptions {
    /// The estimators of a render of `scene` with these options.
    pub fn estimators(&self, scene: &Scene) -> Estimators {
        // A guide's gain drowns in the noise of roulette by throughput (Vorba & Křivánek 2016).
        let guided = !matches!(self.guide.mode, GuideMode::Off) && !self.guide.mode.is_bansal();
        let roulette = self.roulette.unwrap_or(match scene.defaults.roulette {
            _ if self.guide.trial => Roulette::Learnt,
            true if guided => Roulette::Learnt,
            true => Roulette::Throughput,
            false => Roulette::Off,
        });
        Estimators {
            direct_light: self.direct_light.unwrap_or(scene.defaults.direct_light),
            roulette,
            roulette_scale: self.roulette_scale.unwrap_or(match roulette {
                Roulette::Learnt => LEARNT_SCALE,
                _ => 1.0,
            }),
            split: self.split.unwrap_or(1),
            guide: self.guide.mode,
            sampler: self.sampler,
            max_bounces: self.max_bounces.unwrap_or(scene.defaults.max_bounces),
        }
    }

    /// Defaults on the given engine.
    pub fn on(engine: EngineChoice) -> Self {
        RenderOptions { engine, ..Default::default() }
    }

    /// Defaults on the CPU engine, which needs no GPU.
    pub fn cpu() -> Self {
        Self::on(EngineChoice::Cpu)
    }

    pub(super) fn validate(&self, scene: &Scene) -> Result<(), RenderError> {
        let refuse = |option, value: u32, remedy: &str| {
            Err(RenderError::Option { option, value: value.to_string(), remedy: remedy.to_string() })
        };
        if let Some(levels) = self.max_bounces
            && !(1..=64).contains(&levels)
        {
            return refuse("max_bounces", levels, "choose 1 to 64");
        }
        if let Some(pool) = self.pool
            && !(256..=1 << 26).contains(&pool)
        {
            return refuse("pool", pool, "choose 256 to 67108864 rays");
        }
        if let Some(grain) = self.grain
            && !(1..=64).contains(&grain)
        {
            return refuse("grain", grain, "choose 1 to 64");
        }
        if let Some(scale) = self.roulette_scale
            && !(scale.is_finite() && scale > 0.0)
        {
            return Err(RenderError::Option {
                option: "roulette_scale",
                value: scale.to_string(),
                remedy: "choose a finite number above 0".to_string(),
            });
        }
        if let Some(split) = self.split {
            if !(1..=MAX_SPLIT).contains(&split) {
                return refuse("split", split, "choose 1 to 8");
            }
            if split > 1 && self.estimators(scene).roulette != Roulette::Learnt {
                return refuse(
                    "split",
                    split,
                    "only roulette learnt splits paths; choose that, or a split of 1",
                );
            }
        }
        let wavefront = matches!(self.engine, EngineChoice::Auto | EngineChoice::Wavefront);
        if wavefront && self.split > Some(1) && self.schedule == Some(Schedule::Sorted) {
            return refuse(
                "split",
                self.split.unwrap_or(1),
                "the sorted schedule does not split paths; choose another, or a split of 1",
            );
        }
        if let Some(GuideProblem { option, value, remedy }) = self.guide.problem() {
            return Err(RenderError::Option { option, value, remedy: remedy.to_string() });
        }
        if self.roulette == Some(Roulette::Learnt) && self.guide.mode.is_bansal() {
            return Err(RenderError::Option {
                option: "roulette",
                value: Roulette::Learnt.to_string(),
                remedy: format!(
                    "guide {} does not learn how much light there is; choose roulette throughput, or guide adaptive",
                    self.guide.mode
                ),
            });
        }
        let instances = scene.shapes.iter().any(|shape| matches!(shape.geometry, Geometry::Instance(_)));
        if self.instances == Instancing::LaidOut && instances && scene.triangle_count() > MOST_TRIANGLES {
            return Err(RenderError::Option {
                option: "instances",
                value: "laid-out".to_string(),
                remedy: format!(
                    "that would be {} triangles, each in memory by itself; stay within {MOST_TRIANGLES}, or choose auto or shared",
                    scene.triangle_count()
                ),
            });
        }
        let (width, height) = self.size.unwrap_or((scene.camera.width, scene.camera.height));
        check_image_size(width.into(), height.into())?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Name and message of the option that is refused.
    fn refused(options: RenderOptions) -> Option<(&'static str, String)> {
        let scene = Scene::builder("nothing").camera([0.0; 3], [0.0, 0.0, -1.0], 45.0).build().unwrap();
        match options.validate(&scene).err()? {
            RenderError::Option { option, value, remedy } => Some((option, format!("{value}: {remedy}"))),
            other => panic!("{other}"),
        }
    }

    /// Whichever is reached first.
    #[test]
    fn a_budget_is_counted_in_samples() {
        let (time, half) = (Some(Duration::from_secs(2)), Some(0.5));
        let of = |samples, time, error| Budget { samples, time, error }.expected(16, 100.0, 2.0);
        assert_eq!(of(None, None, None), None);
        assert_eq!(
            [of(Some(9), None, None), of(None, time, None), of(None, None, half)],
            [Some(9), Some(200), Some(256)]
        );
        assert_eq!(
            [of(Some(999), time, half), of(Some(9), time, half), of(None, None, Some(0.0))],
            [Some(200), Some(9), Some(u32::MAX)]
        );
    }

    #[test]
    fn guides_are_checked_in_the_library_too() {
        let with = |guide: GuideOptions, roulette| RenderOptions { guide, roulette, ..Default::default() };
        let guide = GuideOptions { mode: GuideMode::Adaptive, ..Default::default() };
        assert_eq!(refused(with(guide, Some(Roulette::Learnt))), None);
        let deep = refused(with(GuideOptions { depth: 8, ..guide }, None)).unwrap();
        assert_eq!(deep, ("guide_depth", "8: choose 0 to 7".to_string()));
        let bansal = GuideOptions { mode: GuideMode::Bansal, ..guide };
        assert_eq!(refused(with(bansal, None)), None);
        let (option, message) = refused(with(bansal, Some(Roulette::Learnt))).unwrap();
        assert!(option == "roulette" && message.contains("guide bansal does not learn"), "{message}");
        for scale in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let options = RenderOptions { roulette_scale: Some(scale), ..Default::default() };
            assert_eq!(refused(options).map(|(option, _)| option), Some("roulette_scale"));
        }
    }

    #[test]
    fn splitting_goes_with_learnt_roulette() {
        let with = |split, roulette| RenderOptions { split: Some(split), roulette, ..Default::default() };
        for split in [0, 9, u32::MAX] {
            let (option, message) = refused(with(split, Some(Roulette::Learnt))).unwrap();
            assert!(option == "split" && message.ends_with("choose 1 to 8"), "{message}");
        }
        for roulette in [None, Some(Roulette::Off), Some(Roulette::Throughput)] {
            let (option, message) = refused(with(2, roulette)).unwrap();
            assert!(option == "split" && message.contains("roulette learnt"), "{message}");
            assert_eq!(refused(with(1, roulette)), None);
        }
        assert_eq!(refused(with(8, Some(Roulette::Learnt))), None);
        let sorted =
            |split| RenderOptions { schedule: Some(Schedule::Sorted), ..with(split, Some(Roulette::Learnt)) };
        let (option, message) = refused(sorted(2)).unwrap();
        assert!(option == "split" && message.contains("the sorted schedule does not split"), "{message}");
        assert_eq!(refused(sorted(1)), None);
        let guide = GuideOptions { mode: GuideMode::Adaptive, ..Default::default() };
        assert_eq!(refused(RenderOptions { guide, ..with(8, None) }), None);
    }
}
