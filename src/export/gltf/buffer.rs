//! The binary part of a glTF file, with its buffer views and accessors.

use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};

/// Binary data with its buffer views and accessors.
#[derive(Default)]
pub(super) struct Buffer {
    pub(super) bytes: Vec<u8>,
    pub(super) views: Vec<Value>,
    pub(super) accessors: Vec<Value>,
}

impl Buffer {
    /// Adds positions; returns their accessor.
    pub(super) fn positions(&mut self, points: &[Point3<f64>]) -> usize {
        let values: Vec<[f32; 3]> = points.iter().map(|point| narrow(point.coords)).collect();
        let bound = |pick: fn(f32, f32) -> f32| {
            let first = values.first().copied().unwrap_or_default();
            values.iter().fold(first, |bound, value| std::array::from_fn(|k| pick(bound[k], value[k])))
        };
        let bounds = json!({ "min": bound(f32::min), "max": bound(f32::max) });
        self.floats(&values, "VEC3", bounds)
    }

    /// Adds vectors; returns their accessor.
    pub(super) fn vectors(&mut self, vectors: &[Vector3<f64>]) -> usize {
        let values: Vec<[f32; 3]> = vectors.iter().map(|vector| narrow(*vector)).collect();
        self.floats(&values, "VEC3", json!({}))
    }

    /// Adds unit quaternions, scalar last; returns their accessor.
    pub(super) fn quaternions(&mut self, quaternions: &[[f32; 4]]) -> usize {
        self.floats(quaternions, "VEC4", json!({}))
    }

    /// Adds times, ascending; returns their accessor.
    pub(super) fn times(&mut self, times_s: &[f64]) -> usize {
        let values: Vec<[f32; 1]> = times_s.iter().map(|time_s| [*time_s as f32]).collect();
        let end = |time: Option<&[f32; 1]>| time.copied().unwrap_or_default();
        let bounds = json!({ "min": end(values.first()), "max": end(values.last()) });
        self.floats(&values, "SCALAR", bounds)
    }

    /// Adds sRGB colors; returns their accessor. glTF uses linear light instead, converted by the sRGB transfer
    /// function (IEC 61966-2-1).
    pub(super) fn colours(&mut self, colours: &[[u8; 3]]) -> usize {
        let light = |value: u8| (linear(value) * f64::from(u16::MAX)).round() as u16;
        let bytes = colours.iter().flat_map(|&[r, g, b]| [light(r), light(g), light(b), u16::MAX]);
        let bytes: Vec<u8> = bytes.flat_map(u16::to_le_bytes).collect();
        // Integers of two bytes, which represent 0 to 1.
        let accessor = json!({ "componentType": 5123, "normalized": true, "type": "VEC4" });
        self.add(&bytes, colours.len(), accessor, json!({}))
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]], kind: &str, bounds: Value) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        // Numbers of four bytes.
        self.add(&bytes, values.len(), json!({ "componentType": 5126, "type": kind }), bounds)
    }

    fn add(&mut self, bytes: &[u8], count: usize, accessor: Value, bounds: Value) -> usize {
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend_from_slice(bytes);
        // Every part is aligned to four bytes, as its numbers are.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut whole = json!({ "bufferView": self.views.len() - 1, "count": count });
        for part in [accessor, bounds] {
            if let (Some(whole), Value::Object(part)) = (whole.as_object_mut(), part) {
                whole.extend(part);
            }
        }
        self.accessors.push(whole);
        self.accessors.len() - 1
    }
}

/// Converts to single precision; values beyond its range are clamped.
fn narrow(vector: Vector3<f64>) -> [f32; 3] {
    vector.map(|value| value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32).into()
}

/// Linear light, 0 to 1, of an sRGB value.
pub(super) fn linear(value: u8) -> f64 {
    let value = f64::from(value) / 255.0;
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}
