//! Each stage of the wavefront engine against the function of the CPU that it is the twin of, item by item.

use super::answers::{Answer, Nudges, ROUNDING, Report};
use crate::recorded_levels::{Flight, Queues};
use crate::support::quad_index;
use glam::Vec3;
use qtracer::film::BlockSum;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::stage::{BLOCK, Counter, Schedule, Stage};
use qtracer::guiding::{LessonLayout, LessonSums, Lessons, Trail, Transition};
use qtracer::scene::compiled::{KIND_GLOSSY, NONE};
use qtracer::scene::shapes::{Hit, Ray, intersect, occluded, shape_info, surface_at};
use qtracer::transport::items::{HitItem, RayItem, ShadowItem};
use qtracer::transport::path::{ShadeOutcome, Transport};
use std::collections::{BTreeMap, BTreeSet};

/// A stage that has run: the queues before it and after it, and who knows what should have happened.
pub struct Stagework<'a> {
    pub transport: &'a Transport<'a>,
    pub key: &'a KernelKey,
    pub schedule: Schedule,
    /// The largest number that positions of the scene are made from.
    pub size: f32,
    /// What bounds are multiplied by: 1 where the adapter computes to the letter.
    pub slack: f64,
    pub before: &'a Queues,
    pub after: &'a Queues,
}

/// How far a nudged question is from the one asked at most: 4 roundings of the numbers that it was made from.
const NUDGE: f32 = 4.0 * ROUNDING as f32;

/// Bounds on the distance of an answer from its twin's; docs/ACCURACY.md has what was measured.
pub const GENERATE_BOUND: f64 = 4.0;
pub const INTERSECT_BOUND: f64 = 8.0;
/// Shading but for glossy materials, whose densities are exp(n · ln x): what the logarithm is off counts up to 87 times, and
/// adapters' exp and ln are off by several roundings.
pub const SHADE_BOUND: f64 = 8.0;
pub const GLOSSY_BOUND: f64 = 2048.0;
/// Light fainter than this is none: adapters may round denormal numbers to 0.
const FAINTEST: f32 = 1e-30;

fn line(ray: &RayItem) -> Ray {
    Ray { origin: ray.origin, direction: ray.direction }
}

impl Stagework<'_> {
    /// What is wrong with the stage, if anything.
    pub fn check(&self, stage: Stage) -> Report {
        let mut report = Report::default();
        match stage {
            Stage::Generate => self.generate(&mut report),
            Stage::Intersect => self.intersect(&mut report),
            Stage::Environment => self.environment(&mut report),
            Stage::Shade(kind) => self.shade(kind, &mut report),
            Stage::Compact => self.compact(&mut report),
            Stage::Shadow => self.shadow(&mut report),
            Stage::Learn => self.learn(&mut report),
            Stage::Resolve => self.resolve(&mut report),
            _ => {}
        }
        report.require(self.after.count(Counter::Overflow) == 0, || "a queue ran over".to_string());
        report
    }

    /// Fresh paths behind the survivors, in order, with black places for their radiance.
    fn generate(&self, report: &mut Report) {
        let [begin, live, next] =
            [Counter::FreshBegin, Counter::Live, Counter::NextPath].map(|c| self.before.count(c));
        for slot in begin..live {
            let path = next - live + slot;
            let found = self.after.ray_in(slot);
            let answer = |ray: &RayItem| {
                let mut answer = Answer::default();
                [ray.path, ray.bounce, ray.pdf.to_bits()].into_iter().for_each(|word| answer.word(word));
                answer.relative("origin", ray.origin);
                answer.vector("direction", ray.direction, 1.0);
                answer.relative("throughput", ray.throughput);
                answer
            };
            let twin = |_: Option<&mut Nudges>| answer(&self.transport.generate(path));
            report.compare(
                &|| format!("path {path}"),
                self.slack * GENERATE_BOUND,
                &answer(&found.ray),
                &twin,
            );
            report.require(self.after.radiance(path) == Vec3::ZERO, || format!("path {path} is not black"));
            report.require(found.trail == Trail::default(), || format!("path {path} remembers {found:?}"));
        }
    }

    /// Every ray in the queue of what it meets, once; the hit itself.
    fn intersect(&self, report: &mut Report) {
        let mut seen = BTreeSet::new();
        for queue in 0..self.key.hit_queues() {
            for i in 0..self.after.hit_count(queue) {
                let hit = self.after.hit(queue, i);
                let ray = self.after.ray_in(hit.slot).ray;
                report.require(seen.insert(hit.slot), || format!("slot {} met twice", hit.slot));
                let twin =
                    |nudges: Option<&mut Nudges>| self.intersect_twin(&self.nudged(&ray, nudges), None);
                let mut found = self.intersect_twin(&ray, Some(hit));
                found.word(queue);
                let twin = |nudges: Option<&mut Nudges>| {
                    let mut twin = twin(nudges);
                    twin.word(self.queue_of(self.nearest(&ray)));
                    twin
                };
                report.compare(
                    &|| format!("{ray:?} met {hit:?}"),
                    self.slack * INTERSECT_BOUND,
                    &found,
                    &twin,
                );
            }
        }
        // Misses have a queue where the environment shines.
        let live = self.after.count(Counter::Live);
        let unseen = (0..live).filter(|slot| !seen.contains(slot)).map(|slot| self.before.ray_in(slot).ray);
        let lost = unseen.filter(|ray| self.key.environment || self.nearest(ray).is_some()).count();
        report.require(lost == 0, || format!("{lost} of {live} rays in no queue"));
    }

    /// The question moved by rounding.
    fn nudged(&self, ray: &RayItem, nudges: Option<&mut Nudges>) -> RayItem {
        let Some(nudges) = nudges else { return *ray };
        RayItem {
            origin: ray.origin + nudges.vector() * (NUDGE * self.size),
            direction: (ray.direction + nudges.vector() * NUDGE).normalize(),
            throughput: ray.throughput * (Vec3::ONE + nudges.vector() * NUDGE),
            pdf: ray.pdf * (1.0 + nudges.number() * NUDGE),
            ..*ray
        }
    }

    fn nearest(&self, ray: &RayItem) -> Option<Hit> {
        intersect(self.transport.scene, line(ray))
    }

    fn queue_of(&self, hit: Option<Hit>) -> u32 {
        match hit {
            None => self.key.hit_queues() - 1,
            Some(hit) => self.key.hit_queue(shape_info(self.transport.scene, hit.shape).kind),
        }
    }

    /// A hit as it was found, or as the twin finds it. Distances count by how far off the shape the point is that they lead
    /// to, in the size of the numbers that they were made from.
    fn intersect_twin(&self, ray: &RayItem, found: Option<HitItem>) -> Answer {
        let scene = self.transport.scene;
        let hit = match found {
            Some(HitItem { shape: NONE, .. }) => None,
            Some(item) => Some(Hit { t: self.refined(ray, item), shape: item.shape }),
            None => self.nearest(ray),
        };
        let mut answer = Answer::default();
        let Some(hit) = hit else {
            answer.word(NONE);
            return answer;
        };
        answer.word(hit.shape);
        let normal = surface_at(scene, line(ray), hit).normal;
        let size = match quad_index(scene, hit.shape) {
            None => {
                let sphere = &scene.spheres[hit.shape as usize];
                (ray.origin - sphere.center).length() + sphere.radius
            }
            Some(i) => (ray.origin - scene.quads[i].corner).length() + hit.t,
        };
        let cosine = ray.direction.dot(normal).abs().max(1e-6);
        answer.vector("distance", Vec3::splat(hit.t), size / cosine);
        answer
    }

    /// Twin of refine_sphere_distance: what shading makes of the distance in the queue.
    fn refined(&self, ray: &RayItem, item: HitItem) -> f32 {
        let Some(sphere) = self.transport.scene.spheres.get(item.shape as usize) else { return item.t };
        let f = ray.origin - sphere.center;
        let b = -f.dot(ray.direction);
        let sum = b.abs() + (item.t - b).abs();
        if item.t.abs() >= 0.5 * sum {
            return item.t;
        }
        let refined = (f.dot(f) - sphere.radius * sphere.radius) / sum.copysign(b);
        if refined > 0.0 { refined } else { item.t }
    }

    /// Misses take the environment's light, and end.
    fn environment(&self, report: &mut Report) {
        let queue = self.key.hit_queues() - 1;
        for i in 0..self.before.hit_count(queue) {
            let slot = self.before.hit(queue, i).slot;
            let ray = self.before.ray_in(slot).ray;
            let light = self.before.radiance(ray.path) + self.transport.environment(&ray);
            let answer = |radiance: Vec3| {
                let mut answer = Answer::default();
                answer.relative("radiance", radiance);
                answer
            };
            let found = answer(self.after.radiance(ray.path));
            report.compare(&|| format!("{ray:?}"), 4.0, &found, &|_| answer(light));
            let dead = self.schedule != Schedule::Compacted || self.after.ray_in(slot).ray.path == NONE;
            report.require(dead, || format!("{ray:?} lives on"));
        }
    }

    /// Hits of one material: light, shadow rays, rays that go on, lessons.
    fn shade(&self, kind: u32, report: &mut Report) {
        let queue = self.key.hit_queue(kind);
        let bound = self.slack * if kind == KIND_GLOSSY { GLOSSY_BOUND } else { SHADE_BOUND };
        let range = |counter| self.before.count(counter)..self.after.count(counter);
        let next = self.next_rays(queue);
        let shadows: BTreeMap<u32, (ShadowItem, Trail)> = range(Counter::Shadows)
            .map(|slot| self.after.shadow(slot))
            .map(|(shadow, trail)| (shadow.path, (shadow, trail)))
            .collect();
        let [rays, shadow_rays] = [Counter::Survivors, Counter::Shadows].map(|counter| range(counter).len());
        let rays = if self.schedule == Schedule::Compacted { next.len() } else { rays };
        let once = next.len() == rays && shadows.len() == shadow_rays;
        report.require(once, || "two rays of one path".to_string());
        let hits: BTreeSet<u32> = (0..self.before.hit_count(queue))
            .map(|i| self.before.ray_in(self.before.hit(queue, i).slot).ray.path)
            .collect();
        let own = next.keys().chain(shadows.keys()).all(|path| hits.contains(path));
        report.require(own, || "a ray of a path that was not there".to_string());
        let mut transitions = Vec::new();
        for i in 0..self.before.hit_count(queue) {
            let item = self.before.hit(queue, i);
            let Flight { ray, trail } = self.before.ray_in(item.slot);
            let hit = Hit { t: self.refined(&ray, item), shape: item.shape };
            let mut found = Answer::default();
            found.relative("radiance", self.after.radiance(ray.path));
            self.shadow_parts(&mut found, shadows.get(&ray.path));
            self.ray_parts(&mut found, next.get(&ray.path));
            let twin =
                |nudges: Option<&mut Nudges>| self.shade_twin(&self.nudged(&ray, nudges), &trail, hit).0;
            report.compare(&|| format!("{ray:?} at {hit:?}"), bound, &found, &twin);
            let transition = self.shade_twin(&ray, &trail, hit).1;
            if transition.value.max(transition.visit) > 0.0 {
                transitions.push(transition);
            }
        }
        let found: Vec<Transition> =
            range(Counter::Transitions).map(|slot| self.after.transition(slot)).collect();
        if self.key.teaches {
            compare_transitions(found, transitions, report);
        }
    }

    /// The rays with which paths of a hit queue go on, by path.
    fn next_rays(&self, queue: u32) -> BTreeMap<u32, Flight> {
        let by_path = |flight: Flight| (flight.ray.path, flight);
        let (before, after) = (self.before, self.after);
        match self.schedule {
            Schedule::Compacted => (0..before.hit_count(queue))
                .map(|i| after.ray_in(before.hit(queue, i).slot))
                .filter(|flight| flight.ray.path != NONE)
                .map(by_path)
                .collect(),
            _ => (before.count(Counter::Survivors)..after.count(Counter::Survivors))
                .map(|slot| by_path(after.ray_out(slot)))
                .collect(),
        }
    }

    fn shade_twin(&self, ray: &RayItem, trail: &Trail, hit: Hit) -> (Answer, Transition) {
        let outcome: ShadeOutcome = self.transport.shade(ray, trail, hit);
        let mut answer = Answer::default();
        answer.relative("radiance", self.before.radiance(ray.path) + outcome.emitted);
        let taught = Trail { slot: trail.slot, weight: outcome.shadow_value, ..Trail::default() };
        let shadow = outcome.shadow.map(|shadow| (shadow, taught));
        self.shadow_parts(&mut answer, shadow.as_ref());
        let flight = outcome.ray.map(|ray| Flight { ray, trail: outcome.trail });
        self.ray_parts(&mut answer, flight.as_ref());
        (answer, outcome.transition)
    }

    fn shadow_parts(&self, answer: &mut Answer, shadow: Option<&(ShadowItem, Trail)>) {
        let shadow = shadow.filter(|(shadow, _)| shadow.radiance.max_element() > FAINTEST);
        answer.word(u32::from(shadow.is_some()));
        let Some((shadow, trail)) = shadow else { return };
        answer.word(shadow.light_shape);
        answer.vector("shadow origin", shadow.origin, self.size);
        answer.vector("shadow direction", shadow.direction, 1.0);
        answer.vector("shadow length", Vec3::splat(shadow.t_max), self.size);
        answer.relative("shadow radiance", shadow.radiance);
        self.trail_parts(answer, trail);
    }

    fn ray_parts(&self, answer: &mut Answer, flight: Option<&Flight>) {
        answer.word(u32::from(flight.is_some()));
        let Some(Flight { ray, trail }) = flight else { return };
        answer.word(ray.bounce);
        answer.vector("origin", ray.origin, self.size);
        answer.vector("direction", ray.direction, 1.0);
        answer.relative("throughput", ray.throughput);
        answer.relative("pdf", Vec3::splat(ray.pdf));
        self.trail_parts(answer, trail);
    }

    fn trail_parts(&self, answer: &mut Answer, trail: &Trail) {
        if self.key.teaches {
            answer.word(trail.slot);
            answer.relative("trail", Vec3::splat(trail.weight));
        }
    }

    /// Survivors in one dense queue, each once and unchanged.
    fn compact(&self, report: &mut Report) {
        let bytes =
            |flight: Flight| [bytemuck::bytes_of(&flight.ray), bytemuck::bytes_of(&flight.trail)].concat();
        let live = (0..self.before.count(Counter::Live)).map(|slot| self.before.ray_in(slot));
        let live: BTreeSet<Vec<u8>> = live.filter(|flight| flight.ray.path != NONE).map(bytes).collect();
        let range = self.before.count(Counter::Survivors)..self.after.count(Counter::Survivors);
        report.items += range.len();
        report.require(range.len() == live.len(), || format!("{} of {}", range.len(), live.len()));
        let found: BTreeSet<Vec<u8>> = range.map(|slot| bytes(self.after.ray_out(slot))).collect();
        report.require(found == live, || "other rays than before".to_string());
    }

    /// The light of shadow rays that nothing is in the way of.
    fn shadow(&self, report: &mut Report) {
        for slot in 0..self.before.count(Counter::ShadowsLive) {
            let (shadow, _) = self.before.shadow(slot);
            let ShadowItem { origin, direction, t_max, light_shape, radiance, path } = shadow;
            let answer = |radiance: Vec3| {
                let mut answer = Answer::default();
                answer.relative("radiance", radiance);
                answer
            };
            let twin = |nudges: Option<&mut Nudges>| {
                let ray = self.nudged(&RayItem { origin, direction, ..Default::default() }, nudges);
                let blocked = occluded(self.transport.scene, line(&ray), t_max, light_shape);
                let arrives = if blocked { Vec3::ZERO } else { radiance };
                answer(self.before.radiance(path) + arrives)
            };
            report.compare(&|| format!("{shadow:?}"), 1.0, &answer(self.after.radiance(path)), &twin);
        }
    }

    /// The sums of what is learnt, to the last unit.
    fn learn(&self, report: &mut Report) {
        let table = self.transport.guidance.unwrap().table;
        let layout = LessonLayout::new(&table.uniforms);
        let mut sums = LessonSums::new(layout);
        let count = self.before.count(Counter::TransitionsLive);
        (0..count).for_each(|i| sums.learn(table, &self.before.transition(i)));
        report.items += count as usize;
        let added = sums.take();
        let sums = |queues: &Queues| Lessons::from_words(layout, &queues.lessons);
        let (before, after) = (sums(self.before), sums(self.after));
        let values = (0..added.values.len()).all(|i| after.values[i] == before.values[i] + added.values[i]);
        report.require(values, || "sums of values differ".to_string());
        let visits = (0..added.visits.len()).all(|i| after.visits[i] == before.visits[i] + added.visits[i]);
        report.require(visits, || "sums of visits differ".to_string());
        let missing =
            (0..added.missing.len()).all(|i| after.missing[i] == before.missing[i] | added.missing[i]);
        report.require(missing, || "marks of missing cells differ".to_string());
    }

    /// Sums and sums of squares of blocks of samples.
    fn resolve(&self, report: &mut Report) {
        let uniforms = self.transport.uniforms;
        let radiance = self.after.all_radiance();
        let (lost, sums) = self.after.block_sums.split_first().unwrap();
        report.require(*lost == 0, || format!("{lost} samples were lost"));
        // The buffer may be larger than what lies in it.
        let count = (uniforms.sample_count.div_ceil(BLOCK) * uniforms.pixel_count) as usize;
        let words = size_of::<BlockSum>() / 4 * count;
        let sums: &[BlockSum] = bytemuck::cast_slice(&sums[..words]);
        for block in 0..uniforms.sample_count.div_ceil(BLOCK) {
            let samples = block * BLOCK..uniforms.sample_count.min((block + 1) * BLOCK);
            for pixel in 0..uniforms.pixel_count {
                let (mut sum, mut sum_sq) = (Vec3::ZERO, Vec3::ZERO);
                for sample in samples.clone() {
                    let value = Vec3::from(radiance[(sample * uniforms.pixel_count + pixel) as usize]);
                    (sum, sum_sq) = (sum + value, sum_sq + value * value);
                }
                let found = &sums[(block * uniforms.pixel_count + pixel) as usize];
                let answer = |sum: Vec3, sum_sq: Vec3| {
                    let mut answer = Answer::default();
                    answer.relative("sum", normal(sum));
                    answer.relative("sum of squares", normal(sum_sq));
                    answer
                };
                let twin = answer(sum, sum_sq);
                let found = answer(Vec3::from(found.sum), Vec3::from(found.sum_sq));
                report.compare(
                    &|| format!("block {block} of pixel {pixel}"),
                    f64::from(BLOCK),
                    &found,
                    &|_| twin.clone(),
                );
            }
        }
    }
}

/// Without denormal components, which adapters may round to 0.
fn normal(v: Vec3) -> Vec3 {
    Vec3::select(v.abs().cmplt(Vec3::splat(f32::MIN_POSITIVE)), Vec3::ZERO, v)
}

/// Transitions know no path, so they are compared as a crowd: those with the same slots in order of their values.
fn compare_transitions(found: Vec<Transition>, twin: Vec<Transition>, report: &mut Report) {
    type Crowd = BTreeMap<(u32, u32, u32), Vec<f32>>;
    let crowd = |transitions: Vec<Transition>| {
        let mut crowd = Crowd::new();
        for t in transitions {
            // Weights of visits are not compared: trails are made from them, and are.
            crowd.entry((t.slot, t.visited, u32::from(t.visit > 0.0))).or_default().push(t.value);
        }
        crowd.values_mut().for_each(|values| values.sort_by(f32::total_cmp));
        crowd
    };
    let (count, found, twin) = (found.len(), crowd(found), crowd(twin));
    let mut unlike = 0;
    let keys: BTreeSet<_> = found.keys().chain(twin.keys()).collect();
    for key in keys {
        let (a, b) =
            (found.get(key).cloned().unwrap_or_default(), twin.get(key).cloned().unwrap_or_default());
        let differs = |(a, b): (&f32, &f32)| (a - b).abs() > 1e-3 * a.max(*b);
        unlike += a.len().abs_diff(b.len()) + a.iter().zip(&b).filter(|&pair| differs(pair)).count();
    }
    report.require(unlike <= 2 * report.of_two_minds + 2 + count / 1000, || {
        format!("{unlike} of {count} transitions unlike")
    });
}
