//! Pieces of tracks that are one object, hidden or out of the picture in between: which they are, and their masks in
//! one folder.
//!
//! The candidates are pairs of pieces of which the second begins within some seconds of the first one's end, near where
//! that leads over the ground ([`places`](super::end_motion)). Views of both are looked at for points in common: SIFT
//! features in their masks, matched, in one arrangement. The decisions of `tracking::merging` are executed and
//! recorded: [`Gap`] of the object that was joined, [`UnmergedTrack`] of those that were not.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::detected::Followed;
use super::end_motion::{EndMotion, Fit, Ground, Spot, course, near};
use super::mask_path;
use crate::features::matching::{MatchOptions, match_features};
use crate::features::rootsift::{FeatureOptions, Features, extract};
use crate::io::{IoError, atomic};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::{images, order};
use crate::pipeline::stages::motion;
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, FrameId, Gap, IdentityEvidence, ObjectId, UnmergedTrack};
use crate::tracking::merging::{Colours, Joints, Pair, Span, agreeing, join, may_be_one};

/// Seconds for which an object may be away.
const MAX_GAP_S: f64 = 10.0;
/// Pairs that are farther apart than this share of what is tolerated are no candidates, not even ones to speak of.
const MAX_PLACE: f64 = 1.5;
/// Fewer features in a view say nothing about what two views have in common.
const MIN_FEATURES: usize = 30;
/// Ratio of the distances to the best and the second best feature below which two match: looser than for tracks, for
/// what is wrong does not keep the arrangement.
const MAX_RATIO: f32 = 0.85;
/// Maximum distance of a point from its position in the arrangement, as a share of the object's side.
const TOLERANCE: f64 = 0.06;

/// A piece of a track.
struct Piece {
    span: Span,
    times_s: (f64, f64),
    beginning: Option<EndMotion>,
    end: Option<EndMotion>,
}

/// Features of a view of an object.
struct ViewFeatures {
    features: Features,
    colours: Option<Colours>,
}

/// Joins the pieces that are one object; the masks of later ones go to the folder of the earliest.
pub(super) fn join_pieces(run: &Run, folder: &Path, followed: &mut Vec<Followed>, outcome: &mut Outcome) -> Result<()> {
    keep_real_gaps(followed, run.frames()?);
    let candidates = candidates(run, folder, followed)?;
    if candidates.pairs.is_empty() {
        return Ok(());
    }
    let pieces = &candidates.pieces;
    let looks = looks(run, folder, followed, &candidates, outcome)?;
    let (_, objects) = order::sfm_options(run)?;
    let matching = MatchOptions { max_ratio: MAX_RATIO, ..*objects.front_end.matching() };
    let pairs: Vec<Pair> = candidates.pairs.iter().map(|pair| compared(pair, pieces, &looks, &matching)).collect();
    let spans: Vec<Span> = pieces.iter().map(|piece| piece.span).collect();
    let Joints { joined, apart } = join(&spans, &pairs);
    for (pair, reason) in apart.iter().filter(|(pair, _)| pair.evidence.place.is_some_and(|place| place <= 1.0)) {
        let (object, reason) = (followed[pair.after].summary.id, reason.clone());
        followed[pair.before].apart.push(UnmergedTrack { object, evidence: pair.evidence, reason });
    }
    outcome.figure("num_joined", joined.len());
    merge(run, folder, followed, &joined)
}

/// Keeps gaps in which a frame lies that has no mask, from the last frame with one to the first.
fn keep_real_gaps(followed: &mut [Followed], frames: &[Frame]) {
    for Followed { summary, frames: seen, .. } in followed {
        let real = |gap: &Gap| {
            let last = *seen.iter().rfind(|frame| **frame < gap.first)?;
            let first = *seen.iter().find(|frame| **frame > last)?;
            let is_real = frames.iter().any(|frame| last < frame.id && frame.id < first);
            is_real.then_some(Gap { last, first, ..*gap })
        };
        summary.gaps = summary.gaps.iter().filter_map(real).collect();
    }
}

/// Pairs that may be one object, and the pieces that they name.
struct Candidates {
    pieces: Vec<Piece>,
    pairs: Vec<Pair>,
}

impl Candidates {
    /// The frames of each piece in which it is to be looked at.
    fn views(&self) -> BTreeMap<usize, BTreeSet<FrameId>> {
        let mut views: BTreeMap<usize, BTreeSet<FrameId>> = BTreeMap::new();
        for pair in &self.pairs {
            let (end, beginning) = (&self.pieces[pair.before].end, &self.pieces[pair.after].beginning);
            for (piece, course) in [(pair.before, end), (pair.after, beginning)] {
                views.entry(piece).or_default().extend(course.iter().flat_map(frames_of));
            }
        }
        views
    }
}

fn frames_of(course: &EndMotion) -> [FrameId; 2] {
    [course.spot.frame, course.largest.frame]
}

fn candidates(run: &Run, folder: &Path, followed: &[Followed]) -> Result<Candidates> {
    let frames = run.frames()?;
    let index: BTreeMap<FrameId, usize> = frames.iter().enumerate().map(|(k, frame)| (frame.id, k)).collect();
    let world = motion::world(run, frames)?;
    let ground = world.as_ref().map(|world| Ground { world, index: &index });
    let pieces: Vec<Option<Piece>> =
        followed.iter().map(|one| piece(run, folder, one, &index, ground.as_ref())).collect::<Result<_, _>>()?;
    let mut pairs = Vec::new();
    for before in 0..pieces.len() {
        for after in 0..pieces.len() {
            let (Some(a), Some(b)) = (&pieces[before], &pieces[after]) else { continue };
            let gap_s = b.times_s.0 - a.times_s.1;
            let is_later = a.span.1 < b.span.0 && gap_s <= MAX_GAP_S;
            if !is_later || !may_be_one(&followed[before].summary, &followed[after].summary) {
                continue;
            }
            let fit = fit(a, b, ground.as_ref());
            let evidence = match fit {
                Some(Fit { place, size, .. }) => {
                    Some(IdentityEvidence { place: Some(place), size: Some(size), ..IdentityEvidence::default() })
                }
                None => linked(&followed[before], &followed[after]),
            };
            let near = evidence.filter(|evidence| evidence.place.is_some_and(|place| place <= MAX_PLACE));
            let is_turned = fit.is_some_and(|fit| fit.is_turned);
            pairs.extend(near.map(|evidence| Pair { before, after, gap_s, evidence, is_turned }));
        }
    }
    // An object without masks is in no pair.
    let nothing = || Piece { span: (FrameId(0), FrameId(0)), times_s: (0.0, 0.0), beginning: None, end: None };
    Ok(Candidates { pieces: pieces.into_iter().map(|piece| piece.unwrap_or_else(nothing)).collect(), pairs })
}

/// Agreement of two tracks over the ground.
fn fit(before: &Piece, after: &Piece, ground: Option<&Ground<'_>>) -> Option<Fit> {
    ground?.fit(before.end.as_ref()?, after.beginning.as_ref()?)
}

/// Evidence of the tracker that two tracks are one object, from the images alone.
fn linked(before: &Followed, after: &Followed) -> Option<IdentityEvidence> {
    let link = after.summary.after.filter(|link| link.provisional == before.summary.provisional)?;
    Some(link.evidence)
}

/// `None` for an object without masks.
fn piece(
    run: &Run,
    folder: &Path,
    followed: &Followed,
    index: &BTreeMap<FrameId, usize>,
    ground: Option<&Ground<'_>>,
) -> Result<Option<Piece>> {
    let frames = run.frames()?;
    let seen = followed.frames.iter().filter_map(|id| Some((*id, frames[*index.get(id)?].time_s)));
    let seen: Vec<(FrameId, f64)> = seen.collect();
    let (Some(first), Some(last)) = (seen.first(), seen.last()) else { return Ok(None) };
    let end = |from_end: &[(FrameId, f64)]| -> Result<Option<EndMotion>> {
        let mut spots = Vec::new();
        for &(id, time_s) in near(from_end) {
            spots.extend(Spot::of(id, time_s, &super::mask_in(run, folder, followed.summary.id, &frames[index[&id]])?));
        }
        Ok(course(&spots, ground))
    };
    let reversed: Vec<_> = seen.iter().rev().copied().collect();
    let (beginning, end) = (end(&seen)?, end(&reversed)?);
    Ok(Some(Piece { span: (first.0, last.0), times_s: (first.1, last.1), beginning, end }))
}

/// Features of each view, by track and frame.
fn looks(
    run: &Run,
    folder: &Path,
    followed: &[Followed],
    candidates: &Candidates,
    outcome: &mut Outcome,
) -> Result<BTreeMap<(usize, FrameId), ViewFeatures>> {
    let views = candidates.views();
    let wanted = views.values().flatten().copied().collect();
    let mut looks = BTreeMap::new();
    images::for_each(run, Stage::Track, wanted, outcome, |frame, picture| {
        for (&piece, _) in views.iter().filter(|(_, frames)| frames.contains(&frame.id)) {
            let mask = super::mask_in(run, folder, followed[piece].summary.id, &frame)?;
            let features = extract(&picture, &mask, &FeatureOptions::object())?;
            looks.insert((piece, frame.id), ViewFeatures { features, colours: Colours::of(&picture, &mask) });
        }
        Ok(())
    })?;
    Ok(looks)
}

/// The pair with what its views have in common.
fn compared(
    pair: &Pair,
    pieces: &[Piece],
    looks: &BTreeMap<(usize, FrameId), ViewFeatures>,
    matching: &MatchOptions,
) -> Pair {
    let (Some(end), Some(beginning)) = (&pieces[pair.before].end, &pieces[pair.after].beginning) else { return *pair };
    let views = |piece: usize, course: &EndMotion| {
        let frames: BTreeSet<FrameId> = frames_of(course).into();
        frames.into_iter().filter_map(|frame| looks.get(&(piece, frame))).collect::<Vec<_>>()
    };
    let (before, after) = (views(pair.before, end), views(pair.after, beginning));
    let both: Vec<(&ViewFeatures, &ViewFeatures)> =
        before.iter().flat_map(|a| after.iter().map(|b| (*a, *b))).collect();
    let similarity =
        |(a, b): &(&ViewFeatures, &ViewFeatures)| Some(a.colours.as_ref()?.similarity(b.colours.as_ref()?));
    let tolerance_px = TOLERANCE * beginning.spot.side_px().max(end.spot.side_px());
    let colours = both.iter().filter_map(similarity).max_by(f64::total_cmp);
    let points = both.iter().filter_map(|(a, b)| in_common(a, b, tolerance_px, matching)).max();
    let (num_points, num_matches) = points.unzip();
    let colours = colours.or(pair.evidence.colours);
    Pair { evidence: IdentityEvidence { colours, num_points, num_matches, ..pair.evidence }, ..*pair }
}

/// Points that two views show in one arrangement, and those that look alike; `None` if a view shows too little.
fn in_common(a: &ViewFeatures, b: &ViewFeatures, tolerance_px: f64, matching: &MatchOptions) -> Option<(usize, usize)> {
    if a.features.len().min(b.features.len()) < MIN_FEATURES {
        return None;
    }
    let at = |features: &Features, k: u32| features.pixels[k as usize].coords.into();
    let matches = match_features(&a.features, &b.features, matching);
    let matches: Vec<_> = matches.iter().map(|[i, j]| (at(&a.features, *i), at(&b.features, *j))).collect();
    Some((agreeing(&matches, tolerance_px), matches.len()))
}

/// Makes one object of the pieces of every joined pair.
fn merge(run: &Run, folder: &Path, followed: &mut Vec<Followed>, joined: &[Pair]) -> Result<()> {
    let mut joined = joined.to_vec();
    // The latest first, so that a chain is gathered in its earliest piece.
    joined.sort_by(|a, b| followed[b.after].summary.first.cmp(&followed[a.after].summary.first));
    let mut renamed: BTreeMap<ObjectId, ObjectId> = BTreeMap::new();
    let mut gone = BTreeSet::new();
    for pair in joined {
        let later = followed[pair.after].clone();
        let earlier = &mut followed[pair.before];
        let (from, to) = (later.summary.id, earlier.summary.id);
        move_masks(run, folder, from, to, &later.frames)?;
        atomic::remove_folder(&folder.join(from.to_string()))?;
        renamed.insert(from, to);
        earlier.take(later, pair.evidence);
        gone.insert(pair.after);
    }
    for followed in followed.iter_mut() {
        for apart in &mut followed.apart {
            while let Some(id) = renamed.get(&apart.object) {
                apart.object = *id;
            }
        }
        let own = followed.summary.id;
        followed.apart.retain(|apart| apart.object != own);
    }
    let mut place = 0..;
    followed.retain(|_| place.next().is_none_or(|k| !gone.contains(&k)));
    Ok(())
}

fn move_masks(run: &Run, folder: &Path, from: ObjectId, to: ObjectId, frames: &[FrameId]) -> Result<()> {
    for frame in run.frames()?.iter().filter(|frame| frames.binary_search(&frame.id).is_ok()) {
        let source = mask_path(folder, from, frame);
        std::fs::rename(&source, mask_path(folder, to, frame)).map_err(IoError::system("rename", &source))?;
    }
    Ok(())
}

impl Followed {
    /// Takes in a piece that was seen later.
    fn take(&mut self, later: Self, evidence: IdentityEvidence) {
        let (Some(&last), Some(&first)) = (self.frames.last(), later.frames.first()) else { return };
        self.summary = self.summary.joined(&later.summary, Gap { last, first, evidence });
        self.frames.extend(later.frames);
        self.apart.extend(later.apart);
    }
}
