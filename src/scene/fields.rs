//! Typed access to the keys of one table, with errors a person can act on.

use glam::DVec3;

use super::document::{Node, Table, Value};
use super::error::{Fault, quoted, suggestion};

/// The keys of one object.
pub(super) struct Fields<'a> {
    table: &'a Table,
}

impl<'a> Fields<'a> {
    /// Fails unless `node` is a table.
    pub fn of(node: &'a Node) -> Result<Self, Fault> {
        match &node.value {
            Value::Table(table) => Ok(Self { table }),
            _ => Err(Fault::new(node.line, format!("must be a table of keys, not {}", node.describe()))),
        }
    }

    /// Refuses keys that are not `known`, suggesting the nearest.
    pub fn only(&self, known: &[&str]) -> Result<(), Fault> {
        match self.table.iter().find(|(key, _)| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some((key, node)) => {
                let hint = suggestion(key, known.iter().copied());
                Err(Fault::new(node.line, format!("unknown key {}{hint}", quoted(key))))
            }
        }
    }

    /// A value as it was written.
    pub fn node(&self, key: &str) -> Option<&'a Node> {
        self.table.get(key)
    }

    /// The fault for a broken rule whose text starts with the key to blame: on that key's line, where there is one.
    pub fn broken(&self, problem: String) -> Fault {
        let key = problem.split(' ').next().unwrap_or_default();
        Fault::new(self.table.get(key).and_then(|node| node.line), problem)
    }

    /// A value that may be left out.
    pub fn get<T: FromNode>(&self, key: &str) -> Result<Option<T>, Fault> {
        let Some(node) = self.table.get(key) else {
            return Ok(None);
        };
        match T::from_node(node) {
            Some(value) => Ok(Some(value)),
            None => {
                Err(Fault::new(node.line, format!("{key} must be {}, not {}", T::EXPECTED, node.describe())))
            }
        }
    }

    /// A value that must be there.
    pub fn need<T: FromNode>(&self, key: &str) -> Result<T, Fault> {
        self.get(key)?.ok_or_else(|| Fault::from(format!("{key} is missing; give {}", T::EXPECTED)))
    }
}

/// What a key may hold. Ranges are validation's affair.
pub(super) trait FromNode: Sized {
    /// For messages: `must be …`.
    const EXPECTED: &'static str;

    fn from_node(node: &Node) -> Option<Self>;
}

impl FromNode for f64 {
    const EXPECTED: &'static str = "a number";

    fn from_node(node: &Node) -> Option<Self> {
        match node.value {
            Value::Number(number) => Some(number),
            _ => None,
        }
    }
}

impl FromNode for DVec3 {
    const EXPECTED: &'static str = "a list of three numbers, such as [0, 1, 0]";

    fn from_node(node: &Node) -> Option<Self> {
        let Value::List(items) = &node.value else {
            return None;
        };
        let [x, y, z] = items.as_slice() else {
            return None;
        };
        Some(DVec3::new(f64::from_node(x)?, f64::from_node(y)?, f64::from_node(z)?))
    }
}

impl FromNode for u32 {
    const EXPECTED: &'static str = "a whole number, 0 to 4294967295";

    fn from_node(node: &Node) -> Option<Self> {
        let number = f64::from_node(node)?;
        let whole = number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number);
        whole.then_some(number as u32)
    }
}

impl FromNode for bool {
    const EXPECTED: &'static str = "true or false";

    fn from_node(node: &Node) -> Option<Self> {
        match node.value {
            Value::Flag(flag) => Some(flag),
            _ => None,
        }
    }
}

impl FromNode for String {
    const EXPECTED: &'static str = "a text in quotes";

    fn from_node(node: &Node) -> Option<Self> {
        match &node.value {
            Value::Text(text) => Some(text.clone()),
            _ => None,
        }
    }
}
