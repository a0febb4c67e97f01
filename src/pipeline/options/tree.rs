//! Given options, laid over others key by key.
//!
//! What a file or a flag gives is a tree of JSON of which most is missing. It lies over the options that are there:
//! what it does not name keeps its value, below `objects` that of an object. Values are taken over one by one, so that
//! whatever does not fit is refused by its path.

use serde_json::{Map, Value, json};

use super::Options;
use super::public::{TUNING, in_tree, spelled};
use super::schema::{self, Node, join, pointer};
use crate::checks::{Checked, OptionError};

impl Options {
    /// These options with those that a tree of JSON gives instead: public ones, and others below `tuning`. Every option
    /// is accepted at either place.
    ///
    /// # Errors
    /// [`OptionError`] for a key that is not in the tree of options, which says the one that may be meant, and for a
    /// value that is none of its option.
    pub fn with_tree(&self, given: &Value) -> Result<Self, OptionError> {
        let mut options = self.clone();
        let mut public = given.clone();
        let tuning = public.as_object_mut().and_then(|group| group.shift_remove(TUNING));
        lay(&mut options, "", schema::root(), &public)?;
        if let Some(tuning) = tuning {
            let spelled = |error: OptionError| OptionError::new(join(TUNING, &error.key), error.reason);
            lay(&mut options, "", schema::root(), &tuning).map_err(spelled)?;
        }
        Ok(options)
    }

    /// These options with one value instead, as a flag gives it: JSON, or a word.
    ///
    /// * `key` – the option's path, separated by dots.
    ///
    /// # Errors
    /// As [`Options::with_tree`].
    pub fn with_value(&self, key: &str, text: &str) -> Result<Self, OptionError> {
        let with = |value: Value| self.with_tree(&key.rsplit('.').fold(value, |inner, name| json!({ name: inner })));
        let word = || with(Value::String(text.to_owned()));
        match serde_json::from_str(text) {
            // A time of 12.5 is a number to JSON and a text to its option.
            Ok(value) => with(value).or_else(|error| word().map_err(|_| error)),
            Err(_) => word(),
        }
    }

    /// Keys of the options whose values differ, as `--set` names them. Threads and the memory limit are not compared.
    pub fn differing(&self, other: &Self) -> Vec<String> {
        let without_machine = |options: &Self| Self { threads: None, memory_limit: None, ..options.clone() };
        let mut keys = Vec::new();
        compare("", &tree(&without_machine(self)), &tree(&without_machine(other)), &mut keys);
        keys.iter().map(|key| spelled(key)).collect()
    }

    /// The value of an option as JSON; `null` for a key that is not in the tree.
    pub fn value(&self, key: &str) -> Value {
        tree(self).pointer(&pointer(in_tree(key))).cloned().unwrap_or_default()
    }
}

/// Adds the paths at which two trees differ: those of leaves, where both have the same groups.
fn compare(path: &str, one: &Value, other: &Value, keys: &mut Vec<String>) {
    match (one, other) {
        (Value::Object(ours), Value::Object(theirs)) if ours.keys().eq(theirs.keys()) => {
            ours.iter().for_each(|(name, value)| compare(&join(path, name), value, &theirs[name], keys));
        }
        _ if one == other => {}
        _ => keys.push(path.to_owned()),
    }
}

fn lay(options: &mut Options, path: &str, schema: &Value, given: &Value) -> Checked {
    match Node::of(schema) {
        Node::Group(known) => lay_group(options, path, known, given),
        Node::ById => named(path, &[], given)?.iter().try_for_each(|(id, value)| put(options, &join(path, id), value)),
        Node::Leaf => put(options, path, given),
    }
}

fn lay_group(options: &mut Options, path: &str, known: &Map<String, Value>, given: &Value) -> Checked {
    let names: Vec<&str> = known.keys().map(String::as_str).collect();
    for (name, value) in named(path, &names, given)? {
        let schema = known.get(name).ok_or_else(|| unknown(path, name, &names))?;
        lay(options, &join(path, name), schema, value)?;
    }
    Ok(())
}

/// The entries of what must be an object of JSON.
fn named<'a>(path: &str, names: &[&str], given: &'a Value) -> Result<&'a Map<String, Value>, OptionError> {
    let wrong = || match names {
        [] => OptionError::new(path, format!("{given}: expected values by object id")),
        _ => OptionError::new(path, format!("{given}: expected a group of options: {}", names.join(", "))),
    };
    given.as_object().ok_or_else(wrong)
}

/// Takes a single value over.
fn put(options: &mut Options, path: &str, value: &Value) -> Checked {
    let mut changed = tree(options);
    if changed.pointer(&pointer(path)) == Some(value) {
        return Ok(());
    }
    let (group, name) = path.rsplit_once('.').unwrap_or(("", path));
    if let Some(group) = changed.pointer_mut(&pointer(group)).and_then(Value::as_object_mut) {
        group.insert(name.to_owned(), value.clone());
    }
    let wrong = |reason: String| OptionError::new(path, reason);
    // The error names no part of a value: of one with parts the value shows which is meant.
    let quoted = if value.is_object() { format!("{value}: ") } else { String::new() };
    let changed: Options = serde_json::from_value(changed).map_err(|error| wrong(format!("{quoted}{error}")))?;
    // Single precision takes 1e300 for infinite, which JSON cannot say.
    if !value.is_null() && tree(&changed).pointer(&pointer(path)).is_some_and(Value::is_null) {
        return Err(wrong(format!("{value}: number out of range")));
    }
    *options = changed;
    Ok(())
}

fn tree(options: &Options) -> Value {
    json!(options)
}

fn unknown(path: &str, name: &str, names: &[&str]) -> OptionError {
    let place = if path.is_empty() { "the tree" } else { path };
    let meant = meant(path, name, names).map_or_else(|| ".".to_owned(), |meant| format!("; did you mean {meant}?"));
    OptionError::new(join(path, name), format!("unknown option{meant} Options of {place}: {}", names.join(", ")))
}

/// Suggestion for an unknown key: the key of the group that is nearly the same, or else its namesakes elsewhere.
fn meant(path: &str, name: &str, names: &[&str]) -> Option<String> {
    // Keys of a similarity from 0.85 (Jaro and Winkler, 0 to 1) count as misspelt.
    let near = names.iter().map(|other| (strsim::jaro_winkler(name, other), other)).filter(|(near, _)| *near >= 0.85);
    if let Some((_, nearest)) = near.max_by(|a, b| a.0.total_cmp(&b.0)) {
        return Some(spelled(&join(path, nearest)));
    }
    let all = schema::leaves(schema::root(), "").into_iter().map(|(path, _)| path);
    let namesakes = all.filter(|path| path.rsplit('.').next() == Some(name));
    let namesakes: Vec<String> = namesakes.map(|path| spelled(&path)).collect();
    (!namesakes.is_empty()).then(|| namesakes.join(" or "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::FrontEndKind;

    fn laid(given: Value) -> Result<Options, OptionError> {
        Options::default().with_tree(&given)
    }

    fn refused(given: Value) -> String {
        laid(given).unwrap_err().to_string()
    }

    #[test]
    fn what_run_json_holds_is_taken_as_it_is() {
        let mut options = Options { seed: 7, only_objects: [crate::scene::ObjectId(3)].into(), ..Options::default() };
        options.objects.front_end.kind = FrontEndKind::Sift;
        for options in [Options::default(), options] {
            let text = serde_json::to_string(&json!({ "options": options })).unwrap();
            let read: Value = serde_json::from_str(&text).unwrap();
            assert_eq!(laid(read["options"].clone()), Ok(options));
        }
    }

    #[test]
    fn what_is_not_given_keeps_the_default_of_its_target() {
        let given =
            json!({ "objects": { "mapper": { "max_starts": 2 }, "front_end": { "video": { "quality": 0.5 } } } });
        let found = laid(given).unwrap();
        let mut expected = Options::default();
        expected.objects.mapper.max_starts = 2;
        expected.objects.front_end.video.quality = 0.5;
        assert_eq!(found, expected);
        assert_ne!(found.objects.mapper, found.background.mapper);
    }

    #[test]
    fn enums_are_replaced_as_a_whole_and_entries_join() {
        let options = laid(json!({ "instances": { "masks": "m" }, "object_models": { "1": "a" } })).unwrap();
        let options =
            options.with_tree(&json!({ "instances": { "model": "x" }, "object_models": { "2": "b" } })).unwrap();
        assert_eq!(options.instances, super::super::Instances::Model("x".into()));
        assert_eq!(options.object_models.len(), 2);
    }

    /// Paths of all groups.
    fn groups(schema: &Value, path: &str) -> Vec<String> {
        let Node::Group(options) = Node::of(schema) else { return Vec::new() };
        let below = options.iter().flat_map(|(name, schema)| groups(schema, &join(path, name)));
        std::iter::once(path.to_owned()).chain(below).collect()
    }

    #[test]
    fn unknown_keys_are_refused_at_every_level() {
        let groups = groups(schema::root(), "");
        assert!(groups.len() > 20, "{groups:?}");
        for path in groups {
            let around = path.rsplit('.').filter(|name| !name.is_empty());
            let given = around.fold(json!({ "no_such_option": 1 }), |inner, name| json!({ name: inner }));
            assert_eq!(laid(given).unwrap_err().key, join(&path, "no_such_option"));
        }
    }

    #[test]
    fn misspelt_and_misplaced_keys_are_told_what_is_meant() {
        let said = refused(json!({ "scale": { "joint": { "independent_point": 5 } } }));
        assert!(said.contains("did you mean tuning.scale.joint.independent_points?"), "{said}");
        let said = refused(json!({ "max_pair_matches": 5 }));
        assert!(said.contains("option max_pair_matches: unknown option"), "{said}");
        let said = refused(json!({ "min_pair_matches": 5 }));
        assert!(
            said.contains(
                "tuning.background.front_end.sift.min_pair_matches or tuning.objects.front_end.sift.min_pair_matches"
            ),
            "{said}"
        );
    }

    #[test]
    fn values_that_are_none_are_refused_by_their_path() {
        let cases = [
            (json!({ "ground": { "min_points": -1 } }), "ground.min_points"),
            (json!({ "ground": { "max_error_px": null } }), "ground.max_error_px"),
            (json!({ "ground": 7 }), "ground"),
            (
                json!({ "background": { "front_end": { "video": { "min_correlation": 1e300 } } } }),
                "background.front_end.video.min_correlation",
            ),
            (json!({ "features": "orb" }), "features"),
            (json!({ "background": { "front_end": { "kind": "orb" } } }), "background.front_end.kind"),
            (json!({ "object_models": { "one": "a" } }), "object_models.one"),
            (json!([1]), ""),
        ];
        for (given, key) in cases {
            assert_eq!(laid(given).unwrap_err().key, key);
        }
    }

    #[test]
    fn flags_give_json_or_words() {
        let with = |key: &str, text: &str| Options::default().with_value(key, text);
        assert_eq!(with("features", "sift").unwrap().features, super::super::FeatureKind::Sift);
        assert_eq!(with("video.start", "12.5").unwrap().video.start, "12.5".parse().ok());
        assert_eq!(with("video.max_dimension", "640").unwrap().video.max_dimension, Some(640));
        assert_eq!(
            with("scale.joint.sigma_distance", "[0.001, 0.002]").unwrap().scale.joint.sigma_distance,
            [0.001, 0.002]
        );
        assert_eq!(with("instances.masks", "dir").unwrap().instances, super::super::Instances::Masks("dir".into()));
        assert!(with("ground.min_points", "many").unwrap_err().to_string().contains("ground.min_points"));
        assert!(with("ground", "many").unwrap_err().to_string().contains("num_neighbors"));
    }
}
