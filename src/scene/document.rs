//! TOML and JSON read into one tree that remembers lines, so that everything after it exists once.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Deserialize, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

use super::error::{Place, SceneError, quoted};

/// A value and where it starts.
#[derive(Debug)]
pub(super) struct Node {
    pub value: Value,
    /// From 1; `None` in JSON.
    pub line: Option<usize>,
}

pub(super) type Table = BTreeMap<String, Node>;

#[derive(Debug)]
pub(super) enum Value {
    /// Integers too: f64 holds every u32.
    Number(f64),
    Text(String),
    Flag(bool),
    List(Vec<Node>),
    Table(Table),
    /// What no scene uses: dates, null.
    Other(&'static str),
}

impl Node {
    /// Parses a TOML document.
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        let lines = Lines::of(text);
        let table = DeTable::parse(text).map_err(|error| SceneError::Syntax {
            place: Place::at(error.span().map(|span| lines.number(span.start))),
            problem: format!("not valid TOML: {}", error.message()),
        })?;
        Ok(Self { value: Value::Table(toml_table(table.into_inner(), &lines)), line: None })
    }

    /// Parses a JSON document; unlike most readers, refuses repeated keys.
    pub fn from_json(text: &str) -> Result<Self, SceneError> {
        serde_json::from_str(text).map_err(|error| {
            let message = error.to_string();
            let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(head, _)| head);
            SceneError::Syntax {
                place: Place::at(Some(error.line()).filter(|&line| line > 0)),
                problem: format!("not valid JSON: {message}"),
            }
        })
    }

    /// What this is, for messages: `not a list of 2`.
    pub fn describe(&self) -> String {
        match &self.value {
            Value::Number(number) if number.abs() >= 1e15 => format!("{number:e}"),
            Value::Number(number) => number.to_string(),
            Value::Text(text) => format!("the text {}", quoted(text)),
            Value::Flag(flag) => flag.to_string(),
            Value::List(items) => format!("a list of {}", items.len()),
            Value::Table(_) => "a table".to_owned(),
            Value::Other(kind) => (*kind).to_owned(),
        }
    }
}

/// Byte offsets of line starts.
struct Lines(Vec<usize>);

impl Lines {
    fn of(text: &str) -> Self {
        Self(text.bytes().enumerate().filter(|&(_, byte)| byte == b'\n').map(|(at, _)| at + 1).collect())
    }

    /// The line of a byte, from 1.
    fn number(&self, offset: usize) -> usize {
        1 + self.0.partition_point(|&start| start <= offset)
    }
}

fn toml_table(table: DeTable<'_>, lines: &Lines) -> Table {
    table.into_iter().map(|(key, value)| (key.into_inner().into_owned(), toml_node(value, lines))).collect()
}

fn toml_node(spanned: Spanned<DeValue<'_>>, lines: &Lines) -> Node {
    let line = Some(lines.number(spanned.span().start));
    let value = match spanned.into_inner() {
        DeValue::String(text) => Value::Text(text.into_owned()),
        DeValue::Integer(number) => Value::Number(integer(&number)),
        DeValue::Float(number) => Value::Number(number.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Boolean(flag) => Value::Flag(flag),
        DeValue::Datetime(_) => Value::Other("a date"),
        DeValue::Array(items) => Value::List(items.into_iter().map(|item| toml_node(item, lines)).collect()),
        DeValue::Table(table) => Value::Table(toml_table(table, lines)),
    };
    Node { value, line }
}

/// Integers beyond 128 bits become infinite, which validation refuses.
fn integer(number: &DeInteger<'_>) -> f64 {
    i128::from_str_radix(number.as_str(), number.radix()).map_or(f64::INFINITY, |integer| integer as f64)
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = deserializer.deserialize_any(AnyValue)?;
        Ok(Self { value, line: None })
    }
}

struct AnyValue;

impl<'de> Visitor<'de> for AnyValue {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_bool<E>(self, flag: bool) -> Result<Value, E> {
        Ok(Value::Flag(flag))
    }

    fn visit_i64<E>(self, number: i64) -> Result<Value, E> {
        Ok(Value::Number(number as f64))
    }

    fn visit_u64<E>(self, number: u64) -> Result<Value, E> {
        Ok(Value::Number(number as f64))
    }

    fn visit_f64<E>(self, number: f64) -> Result<Value, E> {
        Ok(Value::Number(number))
    }

    fn visit_str<E>(self, text: &str) -> Result<Value, E> {
        Ok(Value::Text(text.to_owned()))
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Other("null"))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element()? {
            list.push(item);
        }
        Ok(Value::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut table = Table::new();
        while let Some(key) = entries.next_key::<String>()? {
            if table.contains_key(&key) {
                return Err(A::Error::custom(format_args!(
                    "key {} is given twice; remove one",
                    quoted(&key)
                )));
            }
            table.insert(key, entries.next_value()?);
        }
        Ok(Value::Table(table))
    }
}
