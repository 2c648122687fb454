//! What can be wrong with a scene, said so that it can be put right.

use std::fmt;
use std::path::{Path, PathBuf};

/// Why there is no scene. Each message names the file and line where known, the object, and the remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The file could not be read at all: missing, a directory, too large, not text, neither TOML nor JSON.
    #[error("{}: {problem}", path.display())]
    File {
        /// As given.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The text is not well-formed TOML or JSON.
    #[error("{place}{problem}")]
    Syntax {
        /// Where in the text.
        place: Place,
        /// The parser's words.
        problem: String,
    },
    /// One object of the scene is invalid.
    #[error("{place}{object}: {problem}")]
    Object {
        /// Where it was written; empty for scenes built in code.
        place: Place,
        /// `camera`, `material "glass"`, `shapes[3] "lamp"`, …
        object: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// An image size that can't be rendered (see [`check_image_size`](super::check_image_size)).
    #[error("image size {width} × {height} {problem}")]
    ImageSize {
        /// Columns asked for.
        width: u64,
        /// Rows asked for.
        height: u64,
        /// What is wrong and what to do.
        problem: String,
    },
}

/// Where something was written. Displays as `file:line: `, with whatever is known, or as nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Not known for scenes given as text.
    pub file: Option<PathBuf>,
    /// From 1. Not known for JSON beyond syntax errors.
    pub line: Option<usize>,
}

impl Place {
    /// A line of an unnamed text.
    pub(super) fn at(line: Option<usize>) -> Self {
        Self { file: None, line }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.file, self.line) {
            (Some(file), Some(line)) => write!(f, "{}:{line}: ", file.display()),
            (Some(file), None) => write!(f, "{}: ", file.display()),
            (None, Some(line)) => write!(f, "line {line}: "),
            (None, None) => Ok(()),
        }
    }
}

impl SceneError {
    /// The same error, said to be in `path`.
    pub(super) fn in_file(mut self, path: &Path) -> Self {
        if let Self::Syntax { place, .. } | Self::Object { place, .. } = &mut self {
            place.file = Some(path.to_owned());
        }
        self
    }
}

/// What is wrong with an object, and on which line when that is not the object's own. The caller adds the object's name.
#[derive(Debug)]
pub(super) struct Fault {
    pub line: Option<usize>,
    pub problem: String,
}

impl Fault {
    pub fn new(line: Option<usize>, problem: impl Into<String>) -> Self {
        Self { line, problem: problem.into() }
    }

    /// The error for `object`, which starts at `line`.
    pub fn of(self, object: &str, line: Option<usize>) -> SceneError {
        SceneError::Object {
            place: Place::at(self.line.or(line)),
            object: object.to_owned(),
            problem: self.problem,
        }
    }
}

impl From<String> for Fault {
    fn from(problem: String) -> Self {
        Self::new(None, problem)
    }
}

/// `1 triangle`, `2 triangles`.
pub(super) fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// A user's name in quotes, control characters escaped, cut where too long for a message.
pub(super) fn quoted(name: &str) -> String {
    const LONGEST: usize = 60;
    match name.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{:?}…", &name[..end]),
        None => format!("{name:?}"),
    }
}

/// `; did you mean "white"?` when one of `known` resembles `given`, else the whole list when short, else nothing.
pub(super) fn suggestion<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    const LONGEST_LIST: usize = 8;
    let given: String = given.chars().take(100).collect::<String>().to_lowercase();
    let known: Vec<&str> = known.into_iter().collect();
    let close = |name: &&str| strsim::jaro_winkler(&given, &name.to_lowercase());
    let nearest = known.iter().copied().map(|name| (close(&name), name)).max_by(|a, b| a.0.total_cmp(&b.0));
    match nearest {
        Some((likeness, name)) if likeness > 0.75 => format!("; did you mean {}?", quoted(name)),
        Some(_) if known.len() <= LONGEST_LIST => {
            format!("; use one of {}", known.iter().map(|name| quoted(name)).collect::<Vec<_>>().join(", "))
        }
        Some(_) => String::new(),
        None => "; none is defined".to_owned(),
    }
}
