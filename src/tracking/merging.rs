//! Merging of track pieces of one object that was occluded or out of view in between.
//!
//! Two pieces may be one object if the second begins after the first ends. The evidence for such a pair is an
//! [`IdentityEvidence`]: distance of the second from the prediction by the first, sizes, colors, and the number of
//! image points that both show in the same arrangement ([`consistent_matches`]). [`identity_score`] weighs it. A wrong
//! merge costs more than a missing one, so ambiguous pairs stay unmerged: where two pieces that are visible at the same
//! time may both be the continuation, neither is merged ([`merge_tracks`]).

use std::collections::BTreeMap;

use ::image::RgbImage;

use super::appearance::Appearance;
use super::region::Region;
use super::support::MIN_FRAMES;
use super::track::compatible;
use super::{MIN_SIMILARITY, SURE_SIMILARITY, TrackSummary};
use crate::scene::{FrameId, Gap, IdentityEvidence, Mask};

/// Maximum ratio of the sizes of two views of one object, beyond the effect of distance.
const MAX_SIZE_RATIO: f64 = 2.5;

/// Returns true if a ratio of areas or lengths may be that of two views of one object.
pub(super) fn is_same_size(ratio: f64) -> bool {
    (1.0 / MAX_SIZE_RATIO..=MAX_SIZE_RATIO).contains(&ratio)
}

/// Minimum number of points in the same arrangement that proves identity, to which [`MATCHES_PER_POINT`] adds. Of 20
/// matches made by chance 6 agree in one case of a hundred, of 60 no more than 8 to 9.
const MIN_POINTS: usize = 5;
/// Number of matches that add one to this minimum.
const MATCHES_PER_POINT: usize = 10;
/// Number of common points below which two textured views show two objects.
const FEW_POINTS: usize = 4;
/// Maximum distance from the prediction, as a share of the tolerated one, for an identity by position and colors
/// without enough points.
const SURE_PLACE: f64 = 0.5;
/// Maximum gap of such an identity, seconds.
const SURE_GAP_S: f64 = 1.5;
/// Minimum difference of the scores of two continuations in the same frames.
const MARGIN: f64 = 0.5;

/// First and last frame of a track piece.
pub type Span = (FrameId, FrameId);

/// Two track pieces that may be one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Index of the earlier piece.
    pub before: usize,
    /// Index of the later piece.
    pub after: usize,
    /// Time from the last observation of the one to the first of the other, seconds.
    pub gap_s: f64,
    /// Evidence that both are one object.
    pub evidence: IdentityEvidence,
    /// True if the views show different sides of the vehicle, which have few points in common.
    pub is_turned: bool,
}

/// Decisions on all pairs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergeDecisions {
    /// Pairs that are one object; a piece is at most once the earlier and at most once the later one.
    pub merged: Vec<Pair>,
    /// Pairs that stay unmerged, with the reason.
    pub unmerged: Vec<(Pair, String)>,
}

/// Score of two pieces being one object.
///
/// # Errors
/// The evidence against it, in words.
pub fn identity_score(pair: &Pair) -> Result<f64, String> {
    let IdentityEvidence { place, colours, size, num_points, num_matches } = pair.evidence;
    let Some(place) = place else { return Err("its position cannot be predicted".to_owned()) };
    if place > 1.0 {
        return Err("too far from its predicted position".to_owned());
    }
    let colours = colours.unwrap_or(0.0);
    if colours < MIN_SIMILARITY {
        return Err("different colors".to_owned());
    }
    let by_place = place <= SURE_PLACE && colours >= SURE_SIMILARITY && pair.gap_s <= SURE_GAP_S;
    let least = MIN_POINTS + num_matches.unwrap_or(0) / MATCHES_PER_POINT;
    match num_points {
        Some(points) if points >= least => {}
        // The size of a piece that is partly occluded until its end is no evidence, its points are. The side of a
        // vehicle is two to three times as large as its rear.
        _ if !pair.is_turned && size.is_some_and(|size| !is_same_size(size)) => return Err("different size".to_owned()),
        Some(points) if points < FEW_POINTS && !pair.is_turned => {
            return Err(format!("both are textured, but share only {points} points"));
        }
        _ if by_place => {}
        _ => return Err("neither appearance nor position is conclusive".to_owned()),
    }
    let points = num_points.unwrap_or(0) as f64 / least as f64;
    Ok((1.0 - place) + colours + points.min(2.0))
}

/// Decides which pairs are merged, the shortest gaps first.
///
/// * `spans` – of the pieces that `pairs` names.
pub fn merge_tracks(spans: &[Span], pairs: &[Pair]) -> MergeDecisions {
    let mut decisions = MergeDecisions::default();
    let mut fit: Vec<(Pair, f64)> = Vec::new();
    for pair in pairs {
        match identity_score(pair) {
            Ok(strength) => fit.push((*pair, strength)),
            Err(reason) => decisions.unmerged.push((*pair, reason)),
        }
    }
    fit.sort_by(|(a, _), (b, _)| a.gap_s.total_cmp(&b.gap_s).then((a.before, a.after).cmp(&(b.before, b.after))));
    let (mut after, mut before): (BTreeMap<usize, usize>, BTreeMap<usize, usize>) = Default::default();
    for (pair, strength) in &fit {
        if after.contains_key(&pair.before) || before.contains_key(&pair.after) {
            if decisions.merged.iter().any(|other| is_rival(spans, pair, other)) {
                decisions.unmerged.push((*pair, "another object in the same frames fits better".to_owned()));
            }
            continue;
        }
        let rival = fit.iter().find(|(other, s)| is_rival(spans, pair, other) && *s > strength - MARGIN);
        if rival.is_some() {
            decisions.unmerged.push((*pair, "another object in the same frames fits equally well".to_owned()));
            continue;
        }
        after.insert(pair.before, pair.after);
        before.insert(pair.after, pair.before);
        decisions.merged.push(*pair);
    }
    decisions
}

/// Returns true if two pairs share one piece, on the same side, and the others are visible at the same time.
fn is_rival(spans: &[Span], a: &Pair, b: &Pair) -> bool {
    let overlap = |p: usize, q: usize| match (spans.get(p), spans.get(q)) {
        (Some(p), Some(q)) => p.0 <= q.1 && q.0 <= p.1,
        _ => false,
    };
    let forks = a.before == b.before && a.after != b.after && overlap(a.after, b.after);
    let merges = a.after == b.after && a.before != b.before && overlap(a.before, b.before);
    forks || merges
}

/// Maximum number of matches of two views that one similarity transform explains.
///
/// Every pair of matches proposes one. Views of one object rotate by less than 60° in the image and change their size
/// by less than a factor of 2.5. Random matches do not agree.
///
/// * `matches` – positions in the first and the second view, pixels.
/// * `tolerance_px` – maximum residual in the second view.
pub fn consistent_matches(matches: &[([f64; 2], [f64; 2])], tolerance_px: f64) -> usize {
    // Bounds the cost, which is quadratic in the number.
    const MOST: usize = 120;
    let matches = &matches[..matches.len().min(MOST)];
    let mut most = usize::from(!matches.is_empty());
    for (i, p) in matches.iter().enumerate() {
        for q in &matches[i + 1..] {
            if let Some(similarity) = Similarity::of(p, q, tolerance_px) {
                let near = |m: &&([f64; 2], [f64; 2])| similarity.error_px(m) <= tolerance_px;
                most = most.max(matches.iter().filter(near).count());
            }
        }
    }
    most
}

/// x' = a + s R (x − o).
struct Similarity {
    from: [f64; 2],
    to: [f64; 2],
    /// s cos, s sin.
    turn: [f64; 2],
}

impl Similarity {
    /// Similarity that maps two points to two others; `None` if they are too close together or it is out of bounds.
    fn of(p: &([f64; 2], [f64; 2]), q: &([f64; 2], [f64; 2]), tolerance_px: f64) -> Option<Self> {
        let [u, v] = [q.0[0] - p.0[0], q.0[1] - p.0[1]];
        let [x, y] = [q.1[0] - p.1[0], q.1[1] - p.1[1]];
        let length_sq = u * u + v * v;
        if length_sq <= tolerance_px * tolerance_px {
            return None;
        }
        let turn = [(u * x + v * y) / length_sq, (u * y - v * x) / length_sq];
        let scale = turn[0].hypot(turn[1]);
        // cos 60° is 0.5.
        let is_possible = is_same_size(scale) && turn[0] >= 0.5 * scale;
        is_possible.then_some(Self { from: p.0, to: p.1, turn })
    }

    fn error_px(&self, (from, to): &([f64; 2], [f64; 2])) -> f64 {
        let [u, v] = [from[0] - self.from[0], from[1] - self.from[1]];
        let [c, s] = self.turn;
        (to[0] - self.to[0] - c * u + s * v).hypot(to[1] - self.to[1] - s * u - c * v)
    }
}

/// Color histogram of a mask's pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Colors(Appearance);

impl Colors {
    /// Histogram of the pixels in a mask; `None` with too few of them, or if mask and image differ in size.
    pub fn of(image: &RgbImage, mask: &Mask) -> Option<Self> {
        let region = Region::from_mask(mask).filter(|_| (mask.width(), mask.height()) == image.dimensions())?;
        Appearance::of(image, &region).map(Self)
    }

    /// Bhattacharyya coefficient: 1 for equal histograms, 0 for disjoint ones.
    pub fn similarity(&self, other: &Self) -> f64 {
        self.0.similarity(&other.0).clamp(0.0, 1.0)
    }
}

/// Returns true if two objects may be one by their classes; a class counts only after enough detections.
pub fn are_compatible(a: &TrackSummary, b: &TrackSummary) -> bool {
    let is_named = |summary: &TrackSummary| summary.found.by_detector() >= MIN_FRAMES;
    !(is_named(a) && is_named(b)) || compatible(&a.class, &b.class)
}

impl TrackSummary {
    /// Summary of the object whose consecutive pieces are this one and `later`.
    pub fn merged(&self, later: &Self, gap: Gap) -> Self {
        let mean = |a: (f64, usize), b: (f64, usize)| (a.0 * a.1 as f64 + b.0 * b.1 as f64) / (a.1 + b.1).max(1) as f64;
        let named = |track: &Self| track.found.by_detector();
        let votes = |track: &Self| track.class_confidence * named(track) as f64;
        let masks = |track: &Self| track.found.detected() + track.num_carried;
        let quality = match (self.mask_quality, later.mask_quality) {
            (Some(a), Some(b)) => Some(mean((a, masks(self)), (b, masks(later)))),
            (a, b) => a.or(b),
        };
        Self {
            id: self.id,
            provisional: self.provisional,
            class: if votes(later) > votes(self) { &later.class } else { &self.class }.clone(),
            confidence: mean((self.confidence, self.found.detected()), (later.confidence, later.found.detected())),
            first: self.first,
            last: later.last,
            num_carried: self.num_carried + later.num_carried,
            found: self.found.plus(&later.found),
            num_looks: self.num_looks + later.num_looks,
            num_detector_looks: self.num_detector_looks + later.num_detector_looks,
            class_confidence: mean((self.class_confidence, named(self)), (later.class_confidence, named(later))),
            mask_quality: quality,
            outline: self.outline.max(later.outline),
            gaps: self.gaps.iter().chain([&gap]).chain(&later.gaps).copied().collect(),
            after: self.after,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::support::tests::summary;
    use super::*;
    use crate::math::seeded_rng;
    use crate::scene::DetectionCounts;
    use rand::Rng as _;

    const SURE: IdentityEvidence = IdentityEvidence {
        place: Some(0.2),
        colours: Some(0.95),
        size: Some(1.1),
        num_points: Some(20),
        num_matches: Some(30),
    };

    #[test]
    fn rarely_detected_class_separates_nothing() {
        let of = |class: &str, named: usize| {
            let found = DetectionCounts { detector: named, motion: 40, ..DetectionCounts::default() };
            TrackSummary { class: class.into(), ..summary(found, 0.5, 60) }
        };
        assert!(are_compatible(&of("motorcycle", 1), &of("truck", 20)));
        assert!(are_compatible(&of("car", 20), &of("truck", 20)));
        assert!(!are_compatible(&of("motorcycle", 3), &of("truck", 20)));
    }

    fn pair(before: usize, after: usize, evidence: IdentityEvidence) -> Pair {
        Pair { before, after, gap_s: 1.0, evidence, is_turned: false }
    }

    fn spans(spans: &[(u32, u32)]) -> Vec<Span> {
        spans.iter().map(|&(first, last)| (FrameId(first), FrameId(last))).collect()
    }

    #[test]
    fn each_kind_of_evidence_can_reject() {
        assert!(identity_score(&pair(0, 1, SURE)).is_ok());
        // Common points outweigh the size of a piece that may be partly occluded.
        assert!(identity_score(&pair(0, 1, IdentityEvidence { size: Some(3.0), ..SURE })).is_ok());
        let refused = [
            (IdentityEvidence { place: Some(1.2), ..SURE }, "far"),
            (IdentityEvidence { place: None, ..SURE }, "cannot be predicted"),
            (IdentityEvidence { size: Some(3.0), num_points: Some(7), ..SURE }, "size"),
            (IdentityEvidence { colours: Some(0.5), ..SURE }, "colors"),
            (IdentityEvidence { num_points: Some(1), ..SURE }, "share only"),
            (IdentityEvidence { num_points: Some(7), place: Some(0.8), ..SURE }, "conclusive"),
            (IdentityEvidence { num_points: None, place: Some(0.8), ..SURE }, "conclusive"),
        ];
        for (evidence, why) in refused {
            assert!(identity_score(&pair(0, 1, evidence)).unwrap_err().contains(why), "{why}");
        }
        // Views of different sides have no common points.
        let few = pair(0, 1, IdentityEvidence { num_points: Some(1), ..SURE });
        assert!(identity_score(&Pair { is_turned: true, ..few }).is_ok());
    }

    #[test]
    fn position_and_colors_suffice_for_a_short_gap() {
        let bare = IdentityEvidence { num_points: None, ..SURE };
        assert!(identity_score(&pair(0, 1, bare)).is_ok());
        assert!(identity_score(&Pair { gap_s: 2.0, ..pair(0, 1, bare) }).is_err());
    }

    #[test]
    fn pieces_of_one_object_form_a_chain() {
        let spans = spans(&[(0, 10), (20, 30), (40, 50)]);
        let pairs = [pair(0, 1, SURE), pair(1, 2, SURE), Pair { gap_s: 3.0, ..pair(0, 2, SURE) }];
        let decisions = merge_tracks(&spans, &pairs);
        let ids: Vec<(usize, usize)> = decisions.merged.iter().map(|p| (p.before, p.after)).collect();
        assert_eq!((ids, decisions.unmerged.len()), (vec![(0, 1), (1, 2)], 0));
    }

    #[test]
    fn ambiguous_continuations_stay_unmerged() {
        let pairs = [pair(0, 1, SURE), pair(0, 2, IdentityEvidence { place: Some(0.3), ..SURE })];
        let decisions = merge_tracks(&spans(&[(0, 10), (20, 30), (22, 30)]), &pairs);
        assert_eq!((decisions.merged.len(), decisions.unmerged.len()), (0, 2));
        // A pair with a clearly lower score is no rival.
        let pairs = [pairs[0], pair(0, 2, IdentityEvidence { num_points: None, ..SURE })];
        let decisions = merge_tracks(&spans(&[(0, 10), (20, 30), (22, 30)]), &pairs);
        assert_eq!(decisions.merged, [pairs[0]]);
        assert_eq!(decisions.unmerged.len(), 1);
    }

    #[test]
    fn points_of_one_surface_are_consistent_and_random_ones_are_not() {
        let mut rng = seeded_rng(7, 0);
        let mut random = || [rng.random_range(0.0..100.0), rng.random_range(0.0..60.0)];
        let chance: Vec<_> = (0..60).map(|_| (random(), random())).collect();
        let least = MIN_POINTS + chance.len() / MATCHES_PER_POINT;
        assert!(consistent_matches(&chance, 4.0) < least, "{}", consistent_matches(&chance, 4.0));
        let moved = |[x, y]: [f64; 2]| [40.0 + 1.2 * x - 0.3 * y, 10.0 + 0.3 * x + 1.2 * y];
        let surface: Vec<_> = (0..15).map(|_| random()).map(|from| (from, moved(from))).collect();
        let all: Vec<_> = chance.iter().chain(&surface).copied().collect();
        assert!((15..20).contains(&consistent_matches(&all, 4.0)));
        let mirrored: Vec<_> = (0..15).map(|_| random()).map(|[x, y]| ([x, y], [-x, y])).collect();
        assert!(consistent_matches(&mirrored, 4.0) < MIN_POINTS + 1);
        assert_eq!(consistent_matches(&[], 4.0), 0);
    }
}
