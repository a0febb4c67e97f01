//! What is missing from the result, and why.

use std::collections::BTreeMap;

use crate::report::data::{Data, Missing, Model};
use crate::report::summary::count;

/// Everything that is not there, with the reason.
pub(super) fn missing(data: &Data, names: &[String]) -> Vec<Missing> {
    let mut list = data.missing.clone();
    for (object, name) in data.objects.iter().zip(names).filter(|(o, _)| o.trajectory.is_none()) {
        let reason = object.failure.clone().unwrap_or_else(|| "no reason was recorded".to_owned());
        let what = format!("{name}, seen in {}: no trajectory", count(object.visible.len(), "frame"));
        list.push(Missing { what, reason });
    }
    list.extend(unregistered("Background", &data.background));
    for (object, name) in data.objects.iter().zip(names) {
        list.extend(object.model.iter().flat_map(|m| unregistered(name, m)));
    }
    list
}

/// The unregistered frames of a model, gathered by reason.
fn unregistered(name: &str, model: &Model) -> Vec<Missing> {
    let mut by_reason: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
    for (frame, reason) in &model.unregistered {
        by_reason.entry(reason).or_default().push(frame.0);
    }
    let entry = |(reason, frames): (&str, Vec<u32>)| {
        let what = format!("{name}: {} not registered ({})", count(frames.len(), "frame"), ranges(&frames));
        Missing { what, reason: reason.to_owned() }
    };
    by_reason.into_iter().map(entry).collect()
}

/// "3–7, 9" of ascending numbers; the middle of a long list is left out.
fn ranges(numbers: &[u32]) -> String {
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
        assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1–3, 7, 9–10");
        assert_eq!(ranges(&[]), "");
        let every_other: Vec<_> = (0..40).step_by(2).collect();
        assert_eq!(ranges(&every_other), "0, 2, 4, 6, 8, …, 38");
        assert_eq!(ranges(&[u32::MAX]), u32::MAX.to_string());
    }
}
