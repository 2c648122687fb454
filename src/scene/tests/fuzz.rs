//! No text makes the reader panic, and whatever it accepts is valid.

use proptest::prelude::*;

use super::ROOM;
use crate::scene::{Scene, SceneError};

/// Accepted scenes are valid; refusals have a message.
fn check(result: Result<Scene, SceneError>) {
    match result {
        Ok(scene) => assert_eq!(scene.validate(), Ok(())),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Values that break things, to put in place of any other.
fn odd_value() -> impl Strategy<Value = String> {
    let fixed = [
        "nan",
        "inf",
        "-inf",
        "0",
        "-1",
        "1e999",
        "1e38",
        "-3.5e38",
        "1e-60",
        "\"\"",
        "[]",
        "{}",
        "true",
        "1979-05-27",
        "[0, 0, 0]",
        "[nan, 0, 0]",
        "[1e38, 1e38, 1e38]",
        "[[1, 2, 3]]",
        "99999999999999999999999999999999999999999999",
        "0xffffffffffff",
        "\"white\"",
        "{ type = \"box\" }",
        "'ä\u{1F600}'",
    ];
    prop_oneof![
        prop::sample::select(fixed.to_vec()).prop_map(str::to_owned),
        any::<f64>().prop_map(|number| format!("{number:e}")),
        prop::array::uniform3(any::<f64>()).prop_map(|[x, y, z]| format!("[{x:e}, {y:e}, {z:e}]")),
    ]
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in any::<String>()) {
        check(Scene::from_toml(&text));
        check(Scene::from_json(&text));
    }

    #[test]
    fn arbitrary_values_never_panic(line in 0..ROOM.lines().count(), value in odd_value()) {
        let mutate = |(index, old): (usize, &str)| match old.split_once(" = ") {
            Some((key, _)) if index == line => format!("{key} = {value}\n"),
            _ => format!("{old}\n"),
        };
        check(Scene::from_toml(&ROOM.lines().enumerate().map(mutate).collect::<String>()));
    }

    #[test]
    fn arbitrary_edits_never_panic(at in 0..ROOM.len(), cut in 0..40usize, text in ".{0,8}") {
        let end = (at + cut).min(ROOM.len());
        let edited = format!("{}{text}{}", &ROOM[..at], &ROOM[end..]);
        check(Scene::from_toml(&edited));
    }

    #[test]
    fn truncated_json_never_panics(keep in 0..2000usize) {
        let value: toml::Value = toml::from_str(ROOM).expect("valid TOML");
        let json = serde_json::to_string(&value).expect("finite numbers");
        check(Scene::from_json(&json[..keep.min(json.len())]));
    }
}

#[test]
fn deep_nesting_is_refused() {
    let deep = "[".repeat(200_000);
    check(Scene::from_json(&deep));
    check(Scene::from_toml(&format!("name = {deep}")));
}
