//! Variants of a sequence: what is changed, and by how much. `noise-8` is the kind `noise` at the level 8.

use std::fmt;

use clap::ValueEnum;

/// Kinds of change, each with its levels.
type Sweep = (Kind, &'static [f64]);

/// Variants of a calibration: the sequence as it is, with nothing given, shorter, with other seeds, and worse.
const CALIBRATION: [Sweep; 11] = [
    (Kind::AsItIs, &[0.0]),
    (Kind::Raw, &[0.0]),
    (Kind::Frames, &[30.0, 15.0]),
    (Kind::Seed, &[1.0, 2.0]),
    (Kind::Blur, &[1.5]),
    (Kind::Compression, &[40.0]),
    (Kind::Noise, &[6.0]),
    (Kind::Scale, &[0.5]),
    (Kind::Erosion, &[2.0]),
    (Kind::Dilation, &[2.0]),
    (Kind::Jitter, &[2.0]),
];

/// Variants that are swept until the method breaks down.
const BREAKDOWN: [Sweep; 8] = [
    (Kind::Scale, &[1.0, 0.7, 0.5, 0.35, 0.25, 0.18]),
    (Kind::Hidden, &[0.2, 0.4, 0.6, 0.8]),
    (Kind::Erosion, &[1.0, 2.0, 4.0, 8.0]),
    (Kind::Dilation, &[1.0, 2.0, 4.0, 8.0]),
    (Kind::Jitter, &[1.0, 2.0, 4.0, 8.0]),
    (Kind::Window, &[0.0, 20.0, 40.0]),
    (Kind::Frames, &[30.0, 20.0, 15.0, 10.0, 8.0]),
    (Kind::Noise, &[4.0, 8.0, 16.0, 32.0]),
];

/// Frames of a window.
pub(super) const WINDOW: u32 = 20;

/// Kind of change by a variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Kind {
    /// Nothing.
    AsItIs,
    /// No masks, no ground labels, no intrinsics are given: the video alone.
    Raw,
    /// The first frames alone.
    Frames,
    /// Twenty frames from this one on.
    Window,
    /// The seed.
    Seed,
    /// Blur, standard deviation in pixels.
    Blur,
    /// JPEG at this quality.
    Compression,
    /// Noise, standard deviation in grey levels.
    Noise,
    /// Frames and masks, by this factor.
    Scale,
    /// The target's masks are smaller on every side, pixels.
    Erosion,
    /// They are larger on every side, pixels.
    Dilation,
    /// They are moved in every frame, standard deviation in pixels.
    Jitter,
    /// The target is covered in this share of the frames, in the middle.
    Hidden,
}

impl Kind {
    pub(super) fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// The levels that it takes, least and most; `None` where it has none.
    fn levels(self) -> Option<[f64; 2]> {
        match self {
            Self::AsItIs | Self::Raw => None,
            Self::Frames => Some([3.0, 100_000.0]),
            Self::Window => Some([0.0, 100_000.0]),
            Self::Seed => Some([0.0, 1e9]),
            Self::Blur => Some([0.1, 100.0]),
            Self::Compression => Some([1.0, 100.0]),
            Self::Noise => Some([0.1, 255.0]),
            Self::Scale => Some([0.02, 1.0]),
            Self::Erosion | Self::Dilation => Some([1.0, 200.0]),
            Self::Jitter => Some([0.1, 200.0]),
            Self::Hidden => Some([0.01, 0.95]),
        }
    }

    /// Returns true if its level is an integer.
    fn counts(self) -> bool {
        matches!(self, Self::Frames | Self::Window | Self::Seed | Self::Compression | Self::Erosion | Self::Dilation)
    }

    /// Returns true if images or masks are rewritten for it.
    pub(super) fn is_degraded(self) -> bool {
        !matches!(self, Self::AsItIs | Self::Raw | Self::Frames | Self::Window | Self::Seed)
    }
}

/// A change of one kind by one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Variant {
    /// Kind of change.
    pub(super) kind: Kind,
    /// By how much; 0 for kinds without a level.
    pub(super) level: f64,
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind.levels() {
            None => f.write_str(&self.kind.name()),
            Some(_) => write!(f, "{}-{}", self.kind.name(), self.level),
        }
    }
}

impl Variant {
    /// Reads `noise-8`; says which there are if it is none.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let named = |kind: &Kind| text.strip_prefix(&kind.name()).map(|rest| (*kind, rest));
        let (kind, rest) = Kind::value_variants().iter().find_map(named).ok_or_else(|| {
            let names: Vec<String> = Kind::value_variants().iter().map(|kind| kind.name()).collect();
            format!(
                "'{text}': unknown variant; expected one of {}, most of them with a level, such as noise-8",
                names.join(", ")
            )
        })?;
        let Some([least, most]) = kind.levels() else {
            return if rest.is_empty() {
                Ok(Self { kind, level: 0.0 })
            } else {
                Err(format!("'{text}': this variant has no level"))
            };
        };
        let level: Option<f64> = rest.strip_prefix('-').and_then(|level| level.parse().ok());
        let is_whole = |level: &f64| !kind.counts() || level.fract() == 0.0;
        match level.filter(|level| (least..=most).contains(level)).filter(is_whole) {
            Some(level) => Ok(Self { kind, level }),
            None => Err(format!("'{text}': level missing; give {least} to {most}, such as {}-{least}", kind.name())),
        }
    }

    /// The variants of a list of names, in which `calibration` and `breakdown` stand for many; each once.
    pub(super) fn all(names: &[String]) -> Result<Vec<Self>, String> {
        let mut variants: Vec<Self> = Vec::new();
        for name in names {
            let list = match name.as_str() {
                "calibration" => swept(&CALIBRATION),
                "breakdown" => swept(&BREAKDOWN),
                name => vec![Self::parse(name)?],
            };
            for variant in list {
                if !variants.contains(&variant) {
                    variants.push(variant);
                }
            }
        }
        Ok(variants)
    }
}

fn swept(sweeps: &[Sweep]) -> Vec<Variant> {
    sweeps.iter().flat_map(|(kind, levels)| levels.iter().map(move |&level| Variant { kind: *kind, level })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_lists_hold_each_once() {
        let (calibration, breakdown) = (swept(&CALIBRATION), swept(&BREAKDOWN));
        for variant in calibration.iter().chain(&breakdown) {
            assert_eq!(Variant::parse(&variant.to_string()).as_ref(), Ok(variant));
        }
        let both = Variant::all(&["calibration".into(), "breakdown".into(), "noise-6".into()]).unwrap();
        assert_eq!(both.len(), calibration.len() + breakdown.len() - 6);
    }

    #[test]
    fn what_is_no_variant_says_what_would_be() {
        for (text, said) in [
            ("fog-3", "expected one of as-it-is, raw"),
            ("raw-1", "has no level"),
            ("noise", "level missing"),
            ("noise-x", "level missing"),
            ("noise-NaN", "level missing"),
            ("frames-7.5", "level missing"),
            ("hidden-1", "give 0.01 to 0.95"),
        ] {
            assert!(Variant::parse(text).unwrap_err().contains(said), "{text}");
        }
    }
}
