//! The key figures of a run.

use super::times;
use crate::report::data::{Data, Fact};
use crate::report::summary::count;
use crate::scene::{GroundSource, Unit};

pub(super) fn key_figures(data: &Data) -> Vec<Fact> {
    let background = data.background.reconstruction;
    let times = times(data);
    let mut facts = vec![
        Fact::new("video", format!("{:.1} s", times[times.len() - 1] - times[0]))
            .with_note(count(data.frames.len(), "frame")),
        Fact::new("camera known", share(background.images.len(), data.frames.len())).with_note(format!(
            "{} of {}",
            background.images.len(),
            count(data.frames.len(), "frame")
        )),
        Fact::new("vehicles", data.objects.iter().filter(|o| o.trajectory.is_some()).count().to_string())
            .with_note(format!("with a trajectory, of {} seen", data.objects.len())),
        Fact::new("points", thousands(background.points.len())).with_note("in the background"),
    ];
    if let Some(error) = background.mean_reprojection_error_px() {
        facts.push(Fact::new("reprojection error", format!("{error:.2} px")).with_note("mean over the background"));
    }
    let source = data.ground.map(|g| match g.source {
        GroundSource::Masks => ("masks", "given ground labels"),
        GroundSource::Model => ("segmentation", "ground labels from a network"),
        GroundSource::Geometric => ("geometric", "ground guessed: the dominant plane"),
    });
    facts.push(match source {
        Some((value, note)) => Fact::new("ground", value).with_note(note),
        None => Fact::new("ground", "none").with_note("no ground was found"),
    });
    facts.push(match data.unit {
        Unit::Metre => Fact::new("unit", "metre").with_note("the scale is metric"),
        Unit::Background => Fact::new("unit", "arbitrary").with_note("the scale of the scene is not known"),
    });
    facts
}

fn share(part: usize, whole: usize) -> String {
    if whole == 0 { "–".to_owned() } else { format!("{:.0} %", percentage(part, whole)) }
}

/// Rounded, but 100 only for all and 0 only for none.
fn percentage(part: usize, whole: usize) -> f64 {
    let exact = part as f64 / whole as f64 * 100.0;
    if part == whole || part == 0 { exact } else { exact.round().clamp(1.0, 99.0) }
}

/// 12 345 with thin spaces.
pub(super) fn thousands(n: usize) -> String {
    let digits = n.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    groups.join("\u{202f}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped() {
        assert_eq!(thousands(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(thousands(12), "12");
    }
}
