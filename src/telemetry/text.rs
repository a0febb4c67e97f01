//! Decoding of text and numbers.

use std::borrow::Cow;

/// Decodes the text of a file. A byte order mark selects UTF-16; all else is UTF-8, with invalid bytes (a degree sign
/// of an older encoding) as replacement characters.
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    match bytes {
        [0xff, 0xfe, rest @ ..] => Cow::Owned(utf16(rest, u16::from_le_bytes)),
        [0xfe, 0xff, rest @ ..] => Cow::Owned(utf16(rest, u16::from_be_bytes)),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest),
        all => String::from_utf8_lossy(all),
    }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}

/// One mile per hour, meters per second.
pub(super) const MPH_M_S: f64 = 0.447_04;
/// One knot, meters per second.
pub(super) const KNOT_M_S: f64 = 0.514_444;

/// Maximum line length of telemetry, bytes.
const MAX_LINE: usize = 1 << 16;

/// Refuses a line that is too long to be parsed.
pub(super) fn check_length(line: &str) -> Result<(), String> {
    match line.len() {
        0..=MAX_LINE => Ok(()),
        n => Err(format!("line of {n} characters, a line of telemetry has at most {MAX_LINE}")),
    }
}

/// Start of a text, for a message.
pub(super) fn shown(text: &str) -> String {
    // Maximum number of characters in a message.
    const MAX_CHARS: usize = 40;
    let text = text.trim();
    let cut: String = text.chars().take(MAX_CHARS).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.chars().nth(MAX_CHARS).is_some() { format!("“{cut}…”") } else { format!("“{cut}”") }
}

/// Parses a finite number.
pub(super) fn number(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|value: &f64| value.is_finite())
}

/// Parses the number at the start of a text, such as 17.39 of “17.39m”; returns it and the rest.
pub(super) fn leading_number(text: &str) -> Option<(f64, &str)> {
    let text = text.trim_start();
    let is_part = |(i, c): (usize, char)| c.is_ascii_digit() || c == '.' || (i == 0 && (c == '-' || c == '+'));
    let end = text.char_indices().find(|&at| !is_part(at)).map_or(text.len(), |(i, _)| i);
    Some((number(&text[..end])?, &text[end..]))
}

/// Value of the last digit of a decimal number: 0.001 for “-12.345” and for “-1.2345e1”.
pub(super) fn resolution(text: &str) -> f64 {
    let (mantissa, exponent) = text.trim().split_once(['e', 'E']).unwrap_or((text.trim(), "0"));
    let digits = mantissa.split_once('.').map_or("", |(_, digits)| digits);
    let count = digits.bytes().take_while(u8::is_ascii_digit).count() as i32;
    10f64.powi((exponent.parse::<i32>().unwrap_or(0).clamp(-15, 15) - count).clamp(-15, 15))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_any_encoding_is_text() {
        assert_eq!(decode(b"\xef\xbb\xbf1\n"), "1\n");
        assert_eq!(decode(b"\xff\xfea\x00b\x00"), "ab");
        assert_eq!(decode(b"\xfe\xff\x00a\x00b\x00"), "ab");
        assert_eq!(decode(b"-8.9\xb0"), "-8.9\u{fffd}");
    }

    #[test]
    fn numbers_end_where_their_unit_begins() {
        assert_eq!(leading_number(" -17.39m, x"), Some((-17.39, "m, x")));
        assert_eq!(leading_number("n/a"), None);
        assert_eq!(leading_number("1.2.3"), None);
        assert_eq!((number("NaN"), number("inf"), number("1e999")), (None, None, None));
        assert!((resolution("-12.345") - 1e-3).abs() < 1e-15);
        assert_eq!((resolution("7"), resolution("7.00x"), resolution("1.2345e+01")), (1.0, 0.01, 1e-3));
    }

    #[test]
    fn messages_stay_short() {
        assert_eq!(shown(" a\tb "), "“a b”");
        assert_eq!(shown(&"x".repeat(1000)).chars().count(), 43);
    }
}
