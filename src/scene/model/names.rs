//! Names that differ.

use std::collections::HashMap;

/// Names that are taken, each with the number that is tried next for others of that name. Numbers are never tried twice, so a
/// million materials of one name take a million steps.
#[derive(Debug, Default)]
pub(in crate::scene) struct Names {
    next: HashMap<String, u64>,
}

impl Names {
    /// The names of what there is.
    pub fn of<'a>(taken: impl IntoIterator<Item = &'a str>) -> Names {
        Names { next: taken.into_iter().map(|name| (name.to_owned(), 2)).collect() }
    }

    /// The name, or the name with the first number that makes it new; it is taken then.
    pub fn fresh(&mut self, name: String) -> String {
        let Some(mut number) = self.next.get(&name).copied() else {
            self.next.insert(name.clone(), 2);
            return name;
        };
        loop {
            let numbered = format!("{name} ({number})");
            number += 1;
            if !self.next.contains_key(&numbered) {
                self.next.insert(numbered.clone(), 2);
                self.next.insert(name, number);
                return numbered;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_get_the_first_number_that_is_free() {
        let mut names = Names::of(["wood", "wood (3)"]);
        let found = ["stone", "wood", "wood", "wood (3)", "wood"].map(|name| names.fresh(name.to_owned()));
        assert_eq!(found, ["stone", "wood (2)", "wood (4)", "wood (3) (2)", "wood (5)"]);
    }

    #[test]
    fn numbers_are_not_tried_again() {
        let mut names = Names::default();
        (0..1000).for_each(|_| drop(names.fresh("wood".to_owned())));
        assert_eq!((names.next.len(), names.next["wood"]), (1000, 1001));
    }
}
