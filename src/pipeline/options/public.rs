//! Public options, and the `tuning` object of all others.
//!
//! In code the options are one tree. In files, flags and messages those that users have reasons to set keep their path
//! ([`PUBLIC`]); every other option is below `tuning`. Both spellings are accepted for every option, so that a file
//! stays valid when an option becomes public or ceases to be.

use std::sync::LazyLock;

use serde_json::{Map, Value, json};

use super::Options;
use super::schema::{self, join};

/// Group of all options that are not public.
pub(super) const TUNING: &str = "tuning";

/// The public options by group: targets of flags, choices that depend on the footage, and what documents set.
const PUBLIC: [(&str, &str); 14] = [
    ("video", "start end every max_dimension fps track turning"),
    (
        "",
        "instances flow_model ground_labels features order intrinsics background_model object_models model_files \
         only_objects provider seed threads memory_limit",
    ),
    ("intrinsics_std", "focal principal distortion"),
    ("vehicles", "detector motion mask_network segment_every"),
    ("detector", "confidence classes input_size"),
    ("segmentation", "confidence classes tiling input_size"),
    ("tracker", "track_classes"),
    ("masking", "dilation"),
    ("background", "front_end.kind mapper.max_error_px mapper.max_starts"),
    ("objects", "front_end.kind mapper.max_error_px mapper.max_starts"),
    ("ground_segmentation", "classes input_size"),
    ("ground", "num_neighbors min_points max_error_px max_roll_deg max_slope_deg"),
    ("scale", "method max_relative_std"),
    ("metric", "telemetry time_offset utc_offset camera_height camera_pitch map_points scale known_lengths"),
];

/// Paths of the public options.
static PATHS: LazyLock<Vec<String>> = LazyLock::new(|| {
    PUBLIC.iter().flat_map(|(group, names)| names.split(' ').map(move |name| join(group, name))).collect()
});

/// Returns true for a public option, for a part of its value and for a group with a public option.
pub(super) fn is_public(path: &str) -> bool {
    let is_below = |path: &str, group: &str| path.strip_prefix(group).is_some_and(|rest| rest.starts_with('.'));
    PATHS.iter().any(|public| path == public || is_below(path, public) || is_below(public, path))
}

/// The path of an option as users write it.
pub(super) fn spelled(path: &str) -> String {
    if path.is_empty() || is_public(path) { path.to_owned() } else { join(TUNING, path) }
}

/// The path of an option in the tree.
pub(super) fn in_tree(spelled: &str) -> &str {
    spelled.strip_prefix(TUNING).and_then(|rest| rest.strip_prefix('.')).unwrap_or(spelled)
}

impl Options {
    /// The options as JSON, as in `run.json`: public ones by their paths, all others below `tuning`.
    pub fn to_json(&self) -> Value {
        let mut public = json!(self);
        let mut tuning = Value::Null;
        for (path, _) in schema::leaves(schema::root(), "").iter().filter(|(path, _)| !is_public(path)) {
            if let Some(value) = take(&mut public, path) {
                path.split('.').fold(&mut tuning, |group, name| &mut group[name]).clone_from(&value);
            }
        }
        public[TUNING] = tuning;
        public
    }
}

/// Removes a value, and the groups that become empty.
fn take(tree: &mut Value, path: &str) -> Option<Value> {
    let group = tree.as_object_mut()?;
    let Some((name, rest)) = path.split_once('.') else { return group.shift_remove(path) };
    let inner = group.get_mut(name)?;
    let value = take(inner, rest)?;
    if inner.as_object().is_some_and(Map::is_empty) {
        group.shift_remove(name);
    }
    Some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn public_options_exist_and_are_at_most_sixty() {
        let all: Vec<String> = schema::leaves(schema::root(), "").into_iter().map(|(path, _)| path).collect();
        assert!(PATHS.iter().all(|path| all.iter().any(|known| known == path)), "{all:?}");
        assert!(PATHS.len() <= 60);
    }

    #[test]
    fn the_tree_is_divided_into_public_options_and_tuning() {
        let mut sift = Options::default();
        sift.objects.front_end.kind = crate::features::FrontEndKind::Sift;
        for options in [Options::default(), sift] {
            let tree = options.to_json();
            assert!(tree["ground"].get("min_observations").is_none() && tree.get("prompt").is_none(), "{tree}");
            assert_eq!(tree[TUNING]["ground"]["min_observations"], 4);
            assert!(tree[TUNING].get("seed").is_none() && tree["object_models"].is_object(), "{tree}");
            assert_eq!(Options::default().with_tree(&tree), Ok(options));
        }
    }

    #[test]
    fn both_spellings_are_accepted_and_one_is_named() {
        let with = |key: &str| Options::default().with_value(key, "7");
        assert_eq!(with("tuning.ground.min_observations"), with("ground.min_observations"));
        assert_eq!(with("tuning.ground.min_points"), with("ground.min_points"));
        let options = with("ground.min_observations").unwrap();
        assert_eq!(options.value("tuning.ground.min_observations"), 7);
        assert_eq!(Options::default().differing(&options), ["tuning.ground.min_observations"]);
        for key in ["ground.max_samples", "tuning.ground.max_samples"] {
            let error = Options::default().with_value(key, "0").unwrap().check().unwrap_err().to_string();
            assert!(error.contains("option tuning.ground.max_samples"), "{error}");
        }
        let error = with("tuning.ground.max_sample").unwrap_err();
        assert_eq!(error.key, "tuning.ground.max_sample");
        assert!(error.to_string().contains("did you mean tuning.ground.max_samples?"), "{error}");
    }
}
