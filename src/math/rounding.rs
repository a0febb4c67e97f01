//! Formatting of values with their significant digits, for all human-readable output.

/// Significant digits of a standard deviation.
const STD_DIGITS: i32 = 2;
/// Significant digits of a value whose uncertainty is not known.
const VALUE_DIGITS: i32 = 3;
/// Magnitude below which a value is printed as "almost 0".
const SMALLEST: f64 = 1e-9;
/// Magnitude above which a value is printed as "huge".
const LARGEST: f64 = 1e12;

/// Formats `value ± std` to the second significant digit of the standard deviation: `4.31 ± 0.12`, `1230 ± 560`.
///
/// A standard deviation that is zero, or no number, is not printed.
pub fn with_std(value: f64, std: f64) -> String {
    if !(std.is_finite() && std > 0.0 && value.is_finite()) {
        return figure(value);
    }
    let place = place(std, STD_DIGITS);
    format!("{} ± {}", rounded(value, place), rounded(std, place))
}

/// The value alone, to the digits that [`with_std()`] gives it.
pub fn to_std(value: f64, std: f64) -> String {
    if std.is_finite() && std > 0.0 && value.is_finite() {
        rounded(value, place(std, STD_DIGITS))
    } else {
        figure(value)
    }
}

/// Formats a count with its noun: `1 frame`, `2 frames`.
pub fn counted(number: usize, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}

/// Formats a value with three significant digits.
pub fn figure(value: f64) -> String {
    significant(value, VALUE_DIGITS)
}

/// Formats a fraction as per cent with two significant digits: `0.43 %`, `5.6 %`, `27 %`, `> 1000 %`.
pub fn percent(fraction: f64) -> String {
    let value = 100.0 * fraction;
    match value.abs() {
        v if !v.is_finite() => "unknown".to_owned(),
        v if v > 1000.0 => "> 1000 %".to_owned(),
        v if v >= 99.5 => format!("{} %", rounded(value, 0)),
        _ => format!("{} %", significant(value, 2)),
    }
}

/// Formats a value with `digits` significant digits: no exponent, no NaN, a true minus sign.
pub fn significant(value: f64, digits: i32) -> String {
    match value.abs() {
        v if !v.is_finite() => "unknown".to_owned(),
        0.0 => "0".to_owned(),
        v if v < SMALLEST => "almost 0".to_owned(),
        v if v > LARGEST => if value < 0.0 { "huge and negative" } else { "huge" }.to_owned(),
        v => rounded(value, place(v, digits).min(0)),
    }
}

/// Decimal place of the last of `digits` significant digits: −2 for hundredths.
///
/// Accounts for values rounded up to the next power of ten.
fn place(value: f64, digits: i32) -> i32 {
    let place = value.abs().log10().floor() as i32 + 1 - digits;
    let unit = 10f64.powi(place);
    // 0.0996 with two digits is 0.10.
    if (value.abs() / unit).round() * unit >= 10f64.powi(place + digits) * (1.0 - 1e-12) { place + 1 } else { place }
}

fn rounded(value: f64, place: i32) -> String {
    let unit = 10f64.powi(place);
    let value = if place > 0 { (value / unit).round() * unit } else { value };
    let decimals = (-place).clamp(0, 12) as usize;
    let text = format!("{value:.decimals$}");
    // Zero has no sign.
    if text.chars().any(|c| ('1'..='9').contains(&c)) {
        text.replacen('-', "−", 1)
    } else {
        text.replacen('-', "", 1)
    }
}

/// Formats ascending numbers as ranges, "3–7, 9"; the middle of a long list is omitted.
pub fn ranges(numbers: impl IntoIterator<Item = u32>) -> String {
    let numbers: Vec<u32> = numbers.into_iter().collect();
    let runs: Vec<String> = numbers
        .chunk_by(|a, b| a.checked_add(1) == Some(*b))
        .map(|run| match run {
            [one] => one.to_string(),
            [first, .., last] => format!("{first}–{last}"),
            [] => String::new(),
        })
        .collect();
    if runs.len() > 8 {
        return format!("{}, …, {}", runs[..5].join(", "), runs[runs.len() - 1]);
    }
    runs.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_written_as_ranges() {
        assert_eq!(ranges([1, 2, 3, 7, 9, 10]), "1–3, 7, 9–10");
        assert_eq!(ranges([]), "");
        let every_other: Vec<_> = (0..40).step_by(2).collect();
        assert_eq!(ranges(every_other), "0, 2, 4, 6, 8, …, 38");
        assert_eq!(ranges([u32::MAX]), u32::MAX.to_string());
    }

    #[test]
    fn values_have_the_digits_of_their_deviation() {
        assert_eq!(with_std(4.312, 0.118), "4.31 ± 0.12");
        assert_eq!(with_std(1234.5, 562.0), "1230 ± 560");
        assert_eq!(with_std(0.000_031, 0.000_104), "0.00003 ± 0.00010");
        assert_eq!(with_std(-3.0, 0.0996), "−3.00 ± 0.10");
        assert_eq!(with_std(-0.001, 0.4), "0.00 ± 0.40");
        assert_eq!(
            [with_std(2.345, 0.0), with_std(2.345, f64::NAN), with_std(f64::NAN, 1.0)],
            ["2.35", "2.35", "unknown"]
        );
        assert_eq!(to_std(19.26, 3.4), "19.3");
    }

    #[test]
    fn shares_have_two_digits() {
        let said = [0.004_26, 0.056, 0.1, 0.27, 0.91625, 0.9999, 3.456, 12.0, f64::NAN, -0.02].map(percent);
        let expected = ["0.43 %", "5.6 %", "10 %", "27 %", "92 %", "100 %", "346 %", "> 1000 %", "unknown", "−2.0 %"];
        assert_eq!(said, expected);
    }

    #[test]
    fn figures_have_no_exponent() {
        let said = [1.582e-6, 1234.5, 0.999_9, 1e-300, -1e300, 0.0, f64::INFINITY].map(figure);
        assert_eq!(said, ["0.00000158", "1234", "1.00", "almost 0", "huge and negative", "0", "unknown"]);
    }
}
