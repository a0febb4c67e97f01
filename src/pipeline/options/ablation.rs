//! Switches of single mechanisms, for ablations.

use super::Options;
use crate::checks::OptionError;

/// A mechanism that can be switched off by options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ablation {
    /// Name in `tractrix benchmark --ablate`.
    pub name: &'static str,
    /// Decision record that introduced it.
    pub decision: u32,
    /// Options that switch it off: paths and values as `--set` takes them.
    pub settings: &'static [(&'static str, &'static str)],
}

const fn ablation(name: &'static str, decision: u32, settings: &'static [(&'static str, &'static str)]) -> Ablation {
    Ablation { name, decision, settings }
}

impl Ablation {
    /// All of them, by decision. `docs/decisions/README.md` has the same table and says which decisions have no switch.
    pub const ALL: [Self; 16] = [
        ablation(
            "track-length-limit",
            4,
            &[
                ("tuning.background.mapper.max_track_views", "1000000"),
                ("tuning.objects.mapper.max_track_views", "1000000"),
            ],
        ),
        ablation("joint", 6, &[("scale.method", "least-squares")]),
        ablation("smooth-surface", 6, &[("tuning.scale.joint.smooth_surface", "false")]),
        ablation("drift", 7, &[("tuning.scale.least_squares.drift", "false")]),
        ablation(
            "skip-tied-keyframes",
            10,
            &[
                ("tuning.background.front_end.video.skip_tied_keyframes", "false"),
                ("tuning.objects.front_end.video.skip_tied_keyframes", "false"),
            ],
        ),
        ablation("contact-of-ends", 13, &[("tuning.scale.joint.contact.most_end_view", "0")]),
        ablation("mask-interval", 16, &[("vehicles.segment_every", "1")]),
        ablation("mask-interval-at-rest", 23, &[("tuning.tracker.max_rest_secs", "0")]),
        ablation("small-encoder-input", 23, &[("tuning.prompt.input_size", "448"), ("tuning.prompt.window", "2.5")]),
        ablation("vehicle-path", 19, &[("tuning.ground.vehicle_path", "false")]),
        ablation("ground-poses", 21, &[("tuning.objects.mapper.pose_priors", "false")]),
        ablation("contact-frames", 25, &[("tuning.scale.joint.contact.best_share", "1")]),
        ablation("start-of-stationary", 27, &[("tuning.tracker.start_standing", "0.35")]),
        ablation(
            "coarse-adjustments",
            27,
            &[
                ("tuning.background.mapper.coarse_tolerance", "1e-6"),
                ("tuning.objects.mapper.coarse_tolerance", "1e-6"),
            ],
        ),
        ablation("stationary-ratio", 32, &[("tuning.scale.stationary", "none")]),
        ablation("sub-maps", 35, &[("tuning.scale.joint.align_sub_maps", "false")]),
    ];

    /// The mechanisms that a list names: `all`, or names separated by commas.
    ///
    /// # Errors
    /// The unknown name, and all that there are.
    pub fn listed(list: &str) -> Result<Vec<Self>, String> {
        if list == "all" {
            return Ok(Self::ALL.to_vec());
        }
        let named = |name: &str| {
            let found = Self::ALL.into_iter().find(|ablation| ablation.name == name.trim());
            let names: Vec<&str> = Self::ALL.iter().map(|ablation| ablation.name).collect();
            found.ok_or_else(|| format!("'{name}': unknown mechanism; give all, or some of {}", names.join(", ")))
        };
        list.split(',').map(named).collect()
    }

    /// Options without the mechanism.
    ///
    /// # Errors
    /// [`OptionError`] if the options do not have one of them.
    pub fn without(&self, options: &Options) -> Result<Options, OptionError> {
        self.settings.iter().try_fold(options.clone(), |options, (key, value)| options.with_value(key, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_switch_changes_all_of_its_options_and_the_result_is_valid() {
        let default = Options::default();
        for ablation in Ablation::ALL {
            let changed = ablation.without(&default).unwrap();
            assert!(changed.check().is_ok(), "{}: {:?}", ablation.name, changed.check());
            let keys: Vec<&str> = ablation.settings.iter().map(|(key, _)| *key).collect();
            assert_eq!(default.differing(&changed).len(), keys.len(), "{}", ablation.name);
            assert!(default.differing(&changed).iter().all(|key| keys.contains(&key.as_str())), "{}", ablation.name);
        }
    }

    #[test]
    fn lists_name_mechanisms() {
        assert_eq!(Ablation::listed("all").unwrap().len(), Ablation::ALL.len());
        let named: Vec<&str> = Ablation::listed("joint, drift").unwrap().iter().map(|found| found.name).collect();
        assert_eq!(named, ["joint", "drift"]);
        assert!(Ablation::listed("joints").unwrap_err().contains("vehicle-path"));
    }

    #[test]
    fn the_table_of_the_decisions_has_every_switch() {
        let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/decisions/README.md");
        let page = std::fs::read_to_string(page).unwrap();
        for Ablation { name, settings, .. } in Ablation::ALL {
            let row = page.lines().find(|line| line.contains(&format!("| `{name}` |"))).unwrap_or_default();
            assert!(settings.iter().all(|(key, value)| row.contains(&format!("`{key}={value}`"))), "{name}: {row}");
        }
    }
}
