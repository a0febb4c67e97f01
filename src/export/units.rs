//! Units of tables: converts the unit endings of column and property names together with their values.

use std::str::FromStr;

use serde_json::{Map, Value};

/// Units of speeds and lengths in tables: name endings, factors from m/s and m. Accelerations follow lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Units {
    speed: (&'static str, f64),
    length: (&'static str, f64),
}

impl Default for Units {
    fn default() -> Self {
        Self { speed: ("m_s", 1.0), length: ("m", 1.0) }
    }
}

/// Feet in a meter; the international foot is exactly 0.3048 m.
const FEET: f64 = 1.0 / 0.3048;
/// Miles per hour in a meter per second; the mile is exactly 1609.344 m.
const MPH: f64 = 3600.0 / 1609.344;
/// Kilometers per hour in a meter per second.
pub(super) const KM_H: f64 = 3.6;

impl FromStr for Units {
    type Err = String;

    /// Parses `m/s`, `km/h`, `mph`, `m` or `ft`, or two of them separated by a comma.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut units = Self::default();
        for name in text.split(',').map(str::trim) {
            match name {
                "m/s" => units.speed = ("m_s", 1.0),
                "km/h" => units.speed = ("km_h", KM_H),
                "mph" => units.speed = ("mph", MPH),
                "m" => units.length = ("m", 1.0),
                "ft" => units.length = ("ft", FEET),
                other => return Err(format!("'{other}': no such unit; expected m/s, km/h or mph, and m or ft")),
            }
        }
        Ok(units)
    }
}

impl Units {
    /// Name of a column in these units, and the factor of its values.
    pub(super) fn column(self, name: &str) -> (String, f64) {
        let ((speed, of_speed), (length, of_length)) = (self.speed, self.length);
        let endings = [
            ("_m_s2", format!("_{length}_s2"), of_length),
            ("_m_s", format!("_{speed}"), of_speed),
            ("_m", format!("_{length}"), of_length),
        ];
        let renamed =
            |(ending, unit, factor): (&str, String, f64)| Some((name.strip_suffix(ending)?.to_owned() + &unit, factor));
        endings.into_iter().find_map(renamed).unwrap_or_else(|| (name.to_owned(), 1.0))
    }

    /// A cell with its number scaled, four decimals as in meters; other texts stay unchanged.
    pub(super) fn cell(factor: f64, cell: String) -> String {
        match cell.parse::<f64>() {
            Ok(number) if factor != 1.0 => format!("{:.4}", factor * number),
            _ => cell,
        }
    }

    /// Converts names and numbers of properties to these units.
    pub(super) fn properties(self, properties: Map<String, Value>) -> Map<String, Value> {
        let converted = |(name, value): (String, Value)| {
            let (name, factor) = self.column(&name);
            match value.as_f64() {
                Some(number) if factor != 1.0 => (name, (factor * number).into()),
                _ => (name, value),
            }
        };
        properties.into_iter().map(converted).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_values_change_together() {
        let units: Units = "mph, ft".parse().unwrap();
        let column = |name: &str| units.column(name);
        assert_eq!(column("mean_speed_std_m_s"), ("mean_speed_std_mph".into(), MPH));
        assert_eq!(column("acceleration_m_s2"), ("acceleration_ft_s2".into(), FEET));
        assert_eq!(column("x_smoothed_m"), ("x_smoothed_ft".into(), FEET));
        for other in ["path_units", "speed_units_s", "heading_deg", "time_s", "frame", "focal_x_px"] {
            assert_eq!(column(other), (other.into(), 1.0));
        }
        let kmh: Units = "km/h".parse().unwrap();
        assert_eq!((kmh.column("speed_m_s"), kmh.column("x_m")), (("speed_km_h".into(), 3.6), ("x_m".into(), 1.0)));
        assert_eq!(Units::cell(3.6, "2.5000".into()), "9.0000");
        assert_eq!((Units::cell(3.6, String::new()), Units::cell(1.0, "0.1".into())), (String::new(), "0.1".into()));
        assert!("knots".parse::<Units>().unwrap_err().contains("expected m/s"));
    }
}
