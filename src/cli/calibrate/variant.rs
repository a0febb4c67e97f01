//! Variants of a sequence: what is changed, and by how much. `noise-8` is the kind `noise` at the level 8.

use std::fmt;

/// Variants of a calibration: the sequence as it is, with nothing given, shorter, with other seeds, and worse.
pub(super) const CALIBRATION: [&str; 13] = [
    "as-it-is",
    "raw",
    "frames-30",
    "frames-15",
    "seed-1",
    "seed-2",
    "blur-1.5",
    "compression-40",
    "noise-6",
    "scale-0.5",
    "erosion-2",
    "dilation-2",
    "jitter-2",
];

/// Variants that are swept until the method breaks down.
pub(super) const BREAKDOWN: [&str; 34] = [
    "scale-1",
    "scale-0.7",
    "scale-0.5",
    "scale-0.35",
    "scale-0.25",
    "scale-0.18",
    "hidden-0.2",
    "hidden-0.4",
    "hidden-0.6",
    "hidden-0.8",
    "erosion-1",
    "erosion-2",
    "erosion-4",
    "erosion-8",
    "dilation-1",
    "dilation-2",
    "dilation-4",
    "dilation-8",
    "jitter-1",
    "jitter-2",
    "jitter-4",
    "jitter-8",
    "window-0",
    "window-20",
    "window-40",
    "frames-30",
    "frames-20",
    "frames-15",
    "frames-10",
    "frames-8",
    "noise-4",
    "noise-8",
    "noise-16",
    "noise-32",
];

/// Frames of a window.
pub(super) const WINDOW: u32 = 20;

/// Kind of change by a variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
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
    const ALL: [Self; 13] = [
        Self::AsItIs,
        Self::Raw,
        Self::Frames,
        Self::Window,
        Self::Seed,
        Self::Blur,
        Self::Compression,
        Self::Noise,
        Self::Scale,
        Self::Erosion,
        Self::Dilation,
        Self::Jitter,
        Self::Hidden,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::AsItIs => "as-it-is",
            Self::Raw => "raw",
            Self::Frames => "frames",
            Self::Window => "window",
            Self::Seed => "seed",
            Self::Blur => "blur",
            Self::Compression => "compression",
            Self::Noise => "noise",
            Self::Scale => "scale",
            Self::Erosion => "erosion",
            Self::Dilation => "dilation",
            Self::Jitter => "jitter",
            Self::Hidden => "hidden",
        }
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
            None => f.write_str(self.kind.name()),
            Some(_) => write!(f, "{}-{}", self.kind.name(), self.level),
        }
    }
}

impl Variant {
    /// Reads `noise-8`; says which there are if it is none.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let named = |kind: &Kind| text.strip_prefix(kind.name()).map(|rest| (*kind, rest));
        let (kind, rest) = Kind::ALL.iter().find_map(named).ok_or_else(|| {
            let names: Vec<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
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
            let list: Vec<&str> = match name.as_str() {
                "calibration" => CALIBRATION.to_vec(),
                "breakdown" => BREAKDOWN.to_vec(),
                name => vec![name],
            };
            for name in list {
                let variant = Self::parse(name)?;
                if !variants.contains(&variant) {
                    variants.push(variant);
                }
            }
        }
        Ok(variants)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_lists_hold_each_once() {
        for name in CALIBRATION.iter().chain(&BREAKDOWN) {
            assert_eq!(Variant::parse(name).unwrap().to_string(), *name);
        }
        let both = Variant::all(&["calibration".into(), "breakdown".into(), "noise-6".into()]).unwrap();
        assert_eq!(both.len(), CALIBRATION.len() + BREAKDOWN.len() - 6);
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
