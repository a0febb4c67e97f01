//! Missing and doubtful parts of the result.

use std::collections::BTreeMap;

use crate::math::rounding::ranges;
use crate::report::data::{Data, Missing, Model, Object};
use crate::report::words::{count, plain};
use crate::scene::{ObjectId, Verdict, first_of_each_topic, warning_text};

/// Text where a stage gave no reason.
pub(super) const NO_REASON: &str = "no reason recorded";

/// All missing results with their reasons; vehicles with the same gap and reason share an entry.
pub(super) fn missing(data: &Data, names: &[String]) -> Vec<Missing> {
    let mut list = data.missing.clone();
    let mut lacking: Vec<(&str, String, Vec<String>)> = Vec::new();
    for (object, name) in data.objects.iter().zip(names).filter(|(o, _)| lacks_result(data, o)) {
        let reason = object.failure.clone().unwrap_or_else(|| NO_REASON.to_owned());
        let kind = match object.ground_track {
            Some(_) => "ground track only",
            None if data.is_sfm => "no model",
            None => "no trajectory",
        };
        let who = format!("{name}, visible in {}", count(object.visible.len(), "frame"));
        match lacking.iter_mut().find(|(of, why, _)| *of == kind && *why == reason) {
            Some((.., all)) => all.push(who),
            None => lacking.push((kind, reason, vec![who])),
        }
    }
    list.extend(lacking.into_iter().map(|(kind, reason, all)| {
        let who = if let [one] = &all[..] { one.clone() } else { count(all.len(), "vehicle") };
        Missing { what: format!("{who}: {kind}"), reason }
    }));
    list.extend(unregistered("Background", &data.background));
    for (object, name) in data.objects.iter().zip(names) {
        list.extend(object.model.iter().flat_map(|m| unregistered(name, m)));
    }
    list
}

/// Returns true if an object lacks what was requested: a trajectory, or with `tractrix sfm` a model.
fn lacks_result(data: &Data, object: &Object) -> bool {
    if data.is_sfm { object.model.is_none() } else { object.trajectory.is_none() }
}

/// The unregistered frames of a model, grouped by reason; reasons that differ only in numbers are merged.
fn unregistered(name: &str, model: &Model) -> Vec<Missing> {
    let mut by_reason: BTreeMap<Vec<&str>, (Vec<&str>, Vec<u32>)> = BTreeMap::new();
    for (frame, reason) in &model.unregistered {
        let (reasons, frames) = by_reason.entry(words(reason)).or_default();
        reasons.push(reason);
        frames.push(frame.0);
    }
    let entry = |(words, (reasons, frames)): (Vec<&str>, (Vec<&str>, Vec<u32>))| {
        let what = format!("{name}: not registered in {} ({})", count(frames.len(), "frame"), ranges(frames));
        Missing { what, reason: merged(&words, &reasons) }
    };
    by_reason.into_iter().map(entry).collect()
}

/// A reason without its numbers.
fn words(reason: &str) -> Vec<&str> {
    reason.split(|c: char| c.is_ascii_digit()).filter(|word| !word.is_empty()).collect()
}

/// Merges reasons of equal wording, with their numbers as ranges. Numbers too long to compare stay unchanged.
fn merged(words: &[&str], reasons: &[&str]) -> String {
    let numbers = |reason: &str| -> Vec<Option<u64>> {
        reason.split(|c: char| !c.is_ascii_digit()).filter(|n| !n.is_empty()).map(|n| n.parse().ok()).collect()
    };
    let all: Vec<Vec<Option<u64>>> = reasons.iter().map(|reason| numbers(reason)).collect();
    let begins_with_number = reasons[0].starts_with(|c: char| c.is_ascii_digit());
    let is_even = all.iter().all(|n| n.len() == all[0].len() && n.iter().all(Option::is_some));
    if !is_even || begins_with_number {
        return reasons[0].to_owned();
    }
    let range = |k: usize| {
        let values = all.iter().filter_map(|n| n[k]);
        let (low, high) = (values.clone().min().unwrap_or_default(), values.max().unwrap_or_default());
        if low == high { low.to_string() } else { format!("{low}–{high}") }
    };
    let parts = words.iter().enumerate().map(|(k, word)| {
        let number = if k < all[0].len() { range(k) } else { String::new() };
        format!("{word}{number}")
    });
    parts.collect()
}

/// The warnings that add to the gaps and the verdicts, with the vehicle names of the page.
pub(super) fn warnings(data: &Data, names: &[String], missing: &[Missing]) -> Vec<String> {
    let judged = data.objects.iter().filter_map(|o| o.trajectory);
    let doubts = judged.clone().filter_map(|trajectory| trajectory.scale.reason.as_deref());
    let verdicts = judged.filter_map(|trajectory| trajectory.verdict.as_ref());
    let doubts = doubts.chain(verdicts.flat_map(Verdict::against).map(|reason| reason.says.as_str()));
    let known: Vec<&str> =
        missing.iter().map(|m| m.reason.as_str()).chain(doubts).filter(|r| *r != NO_REASON).collect();
    let is_new =
        |warning: &&String| !known.iter().any(|reason| !reason.is_empty() && warning_text(warning).ends_with(reason));
    let ids: Vec<(ObjectId, &String)> = data.objects.iter().map(|o| o.id).zip(names).collect();
    let new = data.warnings.iter().filter(is_new).cloned().collect();
    first_of_each_topic(new).iter().map(|warning| plain(&named(warning, &ids))).collect()
}

/// A warning with the page's vehicle name in place of "object 2".
fn named(warning: &str, names: &[(ObjectId, &String)]) -> String {
    const OBJECT: &str = "object ";
    let mut out = String::new();
    let mut rest = warning;
    while let Some((before, after)) = rest.split_once(OBJECT) {
        let digits = after.len() - after.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let id = after[..digits].parse().ok().map(ObjectId);
        let name = names.iter().find(|(known, _)| Some(*known) == id).map(|(_, name)| name.as_str());
        out += before;
        out += &name.map_or_else(|| format!("{OBJECT}{}", &after[..digits]), str::to_owned);
        rest = &after[digits..];
    }
    out + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::FrameId;

    #[test]
    fn warnings_are_not_repeated_and_vehicles_have_one_name() {
        let mut world = testing::world();
        world.trajectory.scale.reason = Some("nothing moves".into());
        world.warnings = [
            "object 1: scale undetermined: nothing moves",
            "object 2: no trajectory: too few features [troubleshooting: no-trajectory]",
            "background: 1 of 60 frames are not registered; the commonest reason: dark",
            "object 1 stands before object 2 and object 12, deviation 1e-2",
            "no reason recorded",
        ]
        .map(String::from)
        .to_vec();
        let data = world.data();
        let names: Vec<String> = data.objects.iter().map(crate::report::words::name).collect();
        let missing = missing(&data, &names);
        assert_eq!(missing[0].what, "Object 2, visible in 1 frame: no trajectory");
        assert_eq!(missing[1].what, "Background: not registered in 1 frame (3)");
        let left = warnings(&data, &names, &missing);
        assert_eq!(left, ["Car 1 stands before Object 2 and object 12, deviation 0.0100", NO_REASON]);
    }

    #[test]
    fn reasons_that_differ_in_numbers_are_one() {
        let mut world = testing::world();
        let reason = |frame: u32| format!("too few matches: {}, at least 7 needed", frame % 3);
        let unregistered = (4..9).map(|frame| (FrameId(frame), reason(frame))).chain([(FrameId(2), "dark".into())]);
        world.frames.truncate(10);
        let mut data = world.data();
        data.background.unregistered = unregistered.collect();
        let found = unregistered_of_background(&data);
        assert_eq!(
            found,
            [
                "not registered in 1 frame (2): dark",
                "not registered in 5 frames (4–8): too few matches: 0–2, at least 7 needed"
            ]
        );
        assert_eq!(merged(&[" of ", " agree"], &["3 of 4 agree", "2 of 4 agree"]), "3 of 4 agree");
    }

    fn unregistered_of_background(data: &Data) -> Vec<String> {
        unregistered("", &data.background)
            .into_iter()
            .map(|m| format!("{}: {}", m.what.trim_start_matches(": "), m.reason))
            .collect()
    }
}
