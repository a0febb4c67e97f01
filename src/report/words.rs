//! Numbers and names for readers who are no experts: never an exponent, never NaN.

use super::data::Object;
pub(super) use crate::math::rounding::{counted as count, percent, significant as figure};

/// Text of a missing number.
pub(super) const UNKNOWN: &str = "unknown";
/// The unit of lengths: that of the background reconstruction, whose size is arbitrary.
pub(super) const LENGTH_UNIT: &str = "units";

/// "Car 2".
pub(super) fn name(object: &Object) -> String {
    let class = if object.class.is_empty() { "object" } else { &object.class };
    format!("{} {}", capitalised(class), object.id)
}

/// Text with a capital first letter.
pub(super) fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// 12 345 with thin spaces.
pub(super) fn thousands(n: usize) -> String {
    let digits = n.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    groups.join("\u{202f}")
}

/// A part of a whole in per cent: 100 only for all and 0 only for none.
pub(super) fn share(part: usize, whole: usize) -> String {
    if whole == 0 {
        return UNKNOWN.to_owned();
    }
    let exact = part as f64 / whole as f64 * 100.0;
    let rounded = if part == whole || part == 0 { exact } else { exact.round().clamp(1.0, 99.0) };
    format!("{rounded:.0} %")
}

/// A round number, without more decimals than it has.
pub(super) fn round_figure(v: f64) -> String {
    let decimals = (-v.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{v:.decimals$}")
}

/// A number with the given significant digits and its unit.
pub(super) fn with_unit(v: f64, digits: i32, unit: &str) -> String {
    if v.is_finite() { format!("{} {unit}", figure(v, digits)) } else { UNKNOWN.to_owned() }
}

/// A sentence, such as a warning, with its numbers made readable.
pub(super) fn plain(text: &str) -> String {
    text.split(' ').map(plain_word).collect::<Vec<_>>().join(" ")
}

fn plain_word(word: &str) -> String {
    let core = word.trim_matches(|c: char| "()[],;:.%±".contains(c));
    let said = match core.strip_prefix('-').unwrap_or(core) {
        "NaN" => Some(UNKNOWN.to_owned()),
        "inf" => Some("unlimited".to_owned()),
        _ => exponent(core).map(|v| figure(v, 3)),
    };
    said.map_or_else(|| word.to_owned(), |said| word.replacen(core, &said, 1))
}

/// The value of a number that is written with an exponent.
fn exponent(word: &str) -> Option<f64> {
    let (mantissa, power) = word.split_once(['e', 'E'])?;
    power.parse::<i32>().ok()?;
    mantissa.parse::<f64>().ok()?;
    word.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_keep_their_digits() {
        assert_eq!(figure(0.012_345, 3), "0.0123");
        assert_eq!(figure(1234.5, 3), "1234");
        assert_eq!(figure(-2.0, 2), "−2.0");
        assert_eq!(percent(0.0123), "1.2 %");
        assert_eq!(count(1, "frame"), "1 frame");
        assert_eq!(thousands(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(thousands(12), "12");
        assert_eq!([round_figure(1.0), round_figure(0.05)], ["1", "0.05"]);
        assert_eq!([share(999, 1000), share(1, 1000), share(3, 3), share(0, 0)], ["99 %", "1 %", "100 %", "unknown"]);
    }

    #[test]
    fn invalid_numbers_are_replaced_by_words() {
        for v in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!([figure(v, 2), percent(v), with_unit(v, 3, "m")], ["unknown"; 3]);
        }
        assert_eq!([figure(1e-300, 3), figure(-1e300, 3)], ["almost 0", "huge and negative"]);
    }

    #[test]
    fn sentences_from_elsewhere_become_readable() {
        assert_eq!(
            plain("the ratio is NaN ± inf (deviation 4.512e-2, mean 1.310e0), see 3.954E+3."),
            "the ratio is unknown ± unlimited (deviation 0.0451, mean 1.31), see 3954."
        );
        let as_it_is = "frame 1e of Infinity.mp4, 12.5 %,  e5, 0x1e5: nano-info";
        assert_eq!(plain(as_it_is), as_it_is);
    }
}
