//! How far two answers to the same question are apart, and when that is no fault.

use glam::Vec3;

/// One rounding of a number near 1.
pub const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// What a stage makes of one item: words, which must be equal, and vectors, which rounding moves.
#[derive(Clone, Debug, Default)]
pub struct Answer {
    words: Vec<u32>,
    parts: Vec<Part>,
}

/// A vector, and the size of the numbers that it was made from.
#[derive(Clone, Copy, Debug)]
struct Part {
    name: &'static str,
    value: Vec3,
    scale: f32,
}

impl Answer {
    pub fn word(&mut self, word: u32) {
        self.words.push(word);
    }

    /// A vector whose error is as large as numbers of size `scale` make it.
    pub fn vector(&mut self, name: &'static str, value: Vec3, scale: f32) {
        self.parts.push(Part { name, value, scale });
    }

    /// A vector whose error is relative to its largest component.
    pub fn relative(&mut self, name: &'static str, value: Vec3) {
        self.vector(name, value, value.abs().max_element());
    }

    /// The largest difference between parts, in roundings of their scale and in what the twin's own answers are `spread` by,
    /// and its name; infinite where a word differs.
    pub fn distance(&self, twin: &Answer, spread: &[f64]) -> (f64, &'static str) {
        if self.words != twin.words || self.parts.len() != twin.parts.len() {
            return (f64::INFINITY, "words");
        }
        let spread = spread.iter().copied().chain(std::iter::repeat(0.0));
        let part = |((a, b), spread): ((&Part, &Part), f64)| {
            let off = a.off(b) / (ROUNDING * f64::from(a.scale.max(b.scale)) + spread);
            // Equal is equal, whatever the scale; what is no number is infinitely far.
            let off = if a.value == b.value { 0.0 } else { off };
            (if off.is_nan() { f64::INFINITY } else { off }, a.name)
        };
        let parts = self.parts.iter().zip(&twin.parts).zip(spread).map(part);
        parts.fold((0.0, ""), |worst, part| if part.0 > worst.0 { part } else { worst })
    }

    /// How far each part of the answers to nearby questions is from this one, where they say the same in words.
    fn spread(&self, nearby: &[Answer]) -> Vec<f64> {
        let alike = nearby.iter().filter(|answer| answer.words == self.words);
        let mut spread = vec![0.0f64; self.parts.len()];
        for answer in alike {
            let parts = self.parts.iter().zip(&answer.parts);
            spread.iter_mut().zip(parts).for_each(|(most, (a, b))| *most = most.max(a.off(b)));
        }
        spread
    }
}

impl Part {
    fn off(&self, other: &Part) -> f64 {
        (self.value.as_dvec3() - other.value.as_dvec3()).abs().max_element()
    }
}

/// Numbers that a question is moved by to find out whether it is of two minds: between −1 and 1, the same in every run.
pub struct Nudges(u32);

impl Nudges {
    pub fn new(seed: u32) -> Nudges {
        Nudges(seed.wrapping_mul(2_654_435_761).wrapping_add(12_345))
    }

    pub fn number(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 8_388_608.0 - 1.0
    }

    pub fn vector(&mut self) -> Vec3 {
        Vec3::new(self.number(), self.number(), self.number())
    }
}

/// What came of comparing a stage with its twin.
#[derive(Clone, Debug, Default)]
pub struct Report {
    pub items: usize,
    /// Items of which the twin says what was found, but of a question a rounding away.
    pub of_two_minds: usize,
    pub faults: Vec<String>,
    /// Items whose distance from the twin's first answer is beyond what plain rounding makes: judged by how far the twin's own
    /// answers to nearby questions spread.
    pub by_spread: usize,
    /// The worst distance from the twin's first answer.
    pub plain: f64,
    /// The worst distance as judged, and what it is of.
    pub worst: (f64, &'static str),
}

/// Nearby questions that the twin is asked where its first answer is farther off than plain roundings put it.
const NEARBY: u32 = 24;
const PLAIN: f64 = 4.0;

impl Report {
    /// One item: what the stage found, and the twin's answer to the question, moved a little by the numbers if there are
    /// some.
    pub fn compare(
        &mut self,
        name: &dyn Fn() -> String,
        bound: f64,
        found: &Answer,
        twin: &dyn Fn(Option<&mut Nudges>) -> Answer,
    ) {
        self.items += 1;
        let expected = twin(None);
        let mut distance = found.distance(&expected, &[]);
        self.plain = self.plain.max(if distance.0.is_finite() { distance.0 } else { 0.0 });
        if distance.0 > bound.min(PLAIN) {
            self.by_spread += 1;
            let nearby: Vec<Answer> = (0..NEARBY).map(|i| twin(Some(&mut Nudges::new(i)))).collect();
            let spread = expected.spread(&nearby);
            distance = found.distance(&expected, &spread);
            if distance.0 > bound && nearby.iter().any(|near| found.distance(near, &spread).0 <= bound) {
                self.of_two_minds += 1;
                return;
            }
        }
        if distance.0 > bound {
            let (off, part) = distance;
            self.faults.push(format!("{}: {off:.3} in {part}\n  {found:?}\n  {expected:?}", name()));
        } else if distance.0 > self.worst.0 {
            self.worst = distance;
        }
    }

    /// A law that holds or not.
    pub fn require(&mut self, holds: bool, law: impl FnOnce() -> String) {
        if !holds {
            self.faults.push(law());
        }
    }
}
