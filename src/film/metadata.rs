//! What an image is of, in words.

/// Ordered (key, value) texts kept with an image: scene, seed, samples, engine, version …
///
/// Keys are 1 to 79 printable ASCII characters, values any text without NUL, since that is what PNG and EXR can
/// hold. [`set`](Metadata::set) makes them so, that no render is lost over a name.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Metadata {
    entries: Vec<(String, String)>,
}

impl Metadata {
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an entry at the end, or replaces the value of that key in its place.
    pub fn set(&mut self, key: &str, value: impl ToString) {
        let (key, value) = (clean_key(key), value.to_string().replace('\0', ""));
        match self.entries.iter_mut().find(|(k, _)| *k == key) {
            Some(entry) => entry.1 = value,
            None => self.entries.push((key, value)),
        }
    }

    pub fn get(&self, key: &str) -> Option<&str> {
        self.entries.iter().find(|(k, _)| k == key).map(|(_, value)| value.as_str())
    }

    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.entries.iter().map(|(key, value)| (key.as_str(), value.as_str()))
    }

    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}

/// PNG keywords also have no space at either end and no two in a row.
fn clean_key(key: &str) -> String {
    const MAX_CHARS: usize = 79;
    let printable = key.chars().map(|c| if c.is_ascii_graphic() { c } else { '_' });
    let key: String = printable.take(MAX_CHARS).collect();
    if key.is_empty() { "_".to_string() } else { key }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_keep_their_order_and_keys_are_unique() {
        let mut metadata = Metadata::new();
        metadata.set("seed", 7);
        metadata.set("engine", "cpu");
        metadata.set("seed", 8);
        assert_eq!(metadata.iter().collect::<Vec<_>>(), [("seed", "8"), ("engine", "cpu")]);
        assert_eq!(metadata.get("engine"), Some("cpu"));
        assert_eq!(metadata.get("scene"), None);
    }

    #[test]
    fn keys_and_values_are_made_storable() {
        let mut metadata = Metadata::new();
        metadata.set("", "a\0b");
        metadata.set(" größe", "ü");
        metadata.set(&"x".repeat(200), "");
        let keys: Vec<_> = metadata.iter().map(|(key, _)| key.to_string()).collect();
        assert_eq!(keys, ["_".to_string(), "_gr__e".to_string(), "x".repeat(79)]);
        assert_eq!(metadata.get("_"), Some("ab"));
    }
}
