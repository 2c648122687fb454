//! What was odd about a file: each kind once, however often it was met.

use std::fmt::Display;

use crate::scene::SceneWarning;

/// Oddities, counted by kind.
#[derive(Debug, Default)]
pub(in crate::scene) struct Findings {
    found: Vec<Finding>,
}

#[derive(Debug)]
struct Finding {
    what: &'static str,
    /// Where it was met first.
    first: String,
    count: usize,
}

impl Findings {
    /// `what` says what was done and the remedy; `place` names the object.
    pub fn note(&mut self, what: &'static str, place: impl Display) {
        match self.found.iter_mut().find(|finding| finding.what == what) {
            Some(finding) => finding.count += 1,
            None => self.found.push(Finding { what, first: place.to_string(), count: 1 }),
        }
    }

    /// One warning for each kind, in the order in which they were met.
    pub fn warnings(&self, file: &str) -> Vec<SceneWarning> {
        self.found.iter().map(|finding| finding.warning(file)).collect()
    }
}

impl Finding {
    fn warning(&self, file: &str) -> SceneWarning {
        let Finding { what, first, count } = self;
        let more = if *count > 1 { format!(" and {} more", count - 1) } else { String::new() };
        SceneWarning::InFile { file: file.to_owned(), problem: format!("{first}{more}: {what}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thousand_oddities_of_a_kind_are_one_warning() {
        let mut findings = Findings::default();
        (0..1000).for_each(|node| findings.note("is odd; straighten it", format_args!("node {node}")));
        findings.note("is missing; find it", "texture 7");
        let told: Vec<String> =
            findings.warnings("a.glb").iter().map(|warning| warning.to_string()).collect();
        let expected =
            ["a.glb: node 0 and 999 more: is odd; straighten it", "a.glb: texture 7: is missing; find it"];
        assert_eq!(told, expected);
    }
}
