//! Merging of track pieces of one object that was occluded or out of view in between, and of their masks in one folder.
//!
//! Candidates are pairs of pieces of which the second begins within some seconds of the first one's end, near its
//! prediction over the ground ([`end_motion`](super::end_motion)). Views of both are compared: SIFT features in their
//! masks are matched, and the matches must keep one arrangement. The decisions of `tracking::merging` are executed and
//! recorded: a [`Gap`] of a merged object, an [`UnmergedTrack`] of an unmerged one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::detected::ObjectTrack;
use super::end_motion::{EndMotion, Fit, Ground, MaskObservation, end_frames, estimate_end};
use super::mask_path;
use crate::features::matching::{MatchOptions, match_features};
use crate::features::rootsift::{FeatureOptions, Features, extract};
use crate::io::{IoError, atomic};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::{images, order};
use crate::pipeline::stages::motion;
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, FrameId, Gap, IdentityEvidence, ObjectId, UnmergedTrack};
use crate::tracking::merging::{Colors, MergeDecisions, Pair, Span, are_compatible, consistent_matches, merge_tracks};

/// Maximum gap of a candidate pair, seconds.
const MAX_GAP_S: f64 = 10.0;
/// Maximum distance of a candidate from the prediction, as a share of the tolerance; pairs beyond it are not even
/// reported.
const MAX_PLACE: f64 = 1.5;
/// Minimum number of features in a view; fewer are no evidence of points in common.
const MIN_FEATURES: usize = 30;
/// Ratio of the distances to the best and the second best feature below which two match: looser than for tracks, since
/// wrong matches do not keep the arrangement.
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
    colours: Option<Colors>,
}

/// Merges the pieces that are one object; the masks of later ones move to the folder of the earliest.
pub(super) fn merge_pieces(
    run: &Run,
    folder: &Path,
    tracks: &mut Vec<ObjectTrack>,
    outcome: &mut Outcome,
) -> Result<()> {
    keep_actual_gaps(tracks, run.frames()?);
    let candidates = candidates(run, folder, tracks)?;
    if candidates.pairs.is_empty() {
        return Ok(());
    }
    let pieces = &candidates.pieces;
    let view_features = view_features(run, folder, tracks, &candidates, outcome)?;
    let (_, objects) = order::sfm_options(run)?;
    let matching = MatchOptions { max_ratio: MAX_RATIO, ..*objects.front_end.matching() };
    let pairs: Vec<Pair> =
        candidates.pairs.iter().map(|pair| compare(pair, pieces, &view_features, &matching)).collect();
    let spans: Vec<Span> = pieces.iter().map(|piece| piece.span).collect();
    let MergeDecisions { merged, unmerged } = merge_tracks(&spans, &pairs);
    for (pair, reason) in unmerged.iter().filter(|(pair, _)| pair.evidence.place.is_some_and(|place| place <= 1.0)) {
        let (object, reason) = (tracks[pair.after].summary.id, reason.clone());
        tracks[pair.before].apart.push(UnmergedTrack { object, evidence: pair.evidence, reason });
    }
    outcome.figure("num_joined", merged.len());
    merge(run, folder, tracks, &merged)
}

/// Keeps gaps that contain a frame without a mask, from the last frame with one to the first.
fn keep_actual_gaps(tracks: &mut [ObjectTrack], frames: &[Frame]) {
    for ObjectTrack { summary, frames: seen, .. } in tracks {
        let real = |gap: &Gap| {
            let last = *seen.iter().rfind(|frame| **frame < gap.first)?;
            let first = *seen.iter().find(|frame| **frame > last)?;
            let is_real = frames.iter().any(|frame| last < frame.id && frame.id < first);
            is_real.then_some(Gap { last, first, ..*gap })
        };
        summary.gaps = summary.gaps.iter().filter_map(real).collect();
    }
}

/// Pairs that may be one object, and their pieces.
struct Candidates {
    pieces: Vec<Piece>,
    pairs: Vec<Pair>,
}

impl Candidates {
    /// Frames of each piece whose views are compared.
    fn views(&self) -> BTreeMap<usize, BTreeSet<FrameId>> {
        let mut views: BTreeMap<usize, BTreeSet<FrameId>> = BTreeMap::new();
        for pair in &self.pairs {
            let (end, beginning) = (&self.pieces[pair.before].end, &self.pieces[pair.after].beginning);
            for (piece, end_motion) in [(pair.before, end), (pair.after, beginning)] {
                views.entry(piece).or_default().extend(end_motion.iter().flat_map(frames_of));
            }
        }
        views
    }
}

fn frames_of(end_motion: &EndMotion) -> [FrameId; 2] {
    [end_motion.observation.frame, end_motion.largest.frame]
}

fn candidates(run: &Run, folder: &Path, tracks: &[ObjectTrack]) -> Result<Candidates> {
    let frames = run.frames()?;
    let index: BTreeMap<FrameId, usize> = frames.iter().enumerate().map(|(k, frame)| (frame.id, k)).collect();
    let world = motion::world(run, frames)?;
    let ground = world.as_ref().map(|world| Ground { world, index: &index });
    let pieces: Vec<Option<Piece>> =
        tracks.iter().map(|track| piece(run, folder, track, &index, ground.as_ref())).collect::<Result<_, _>>()?;
    let mut pairs = Vec::new();
    for before in 0..pieces.len() {
        for after in 0..pieces.len() {
            let (Some(a), Some(b)) = (&pieces[before], &pieces[after]) else { continue };
            let gap_s = b.times_s.0 - a.times_s.1;
            let is_later = a.span.1 < b.span.0 && gap_s <= MAX_GAP_S;
            if !is_later || !are_compatible(&tracks[before].summary, &tracks[after].summary) {
                continue;
            }
            let fit = fit(a, b, ground.as_ref());
            let evidence = match fit {
                Some(Fit { place, size, .. }) => {
                    Some(IdentityEvidence { place: Some(place), size: Some(size), ..IdentityEvidence::default() })
                }
                None => linked(&tracks[before], &tracks[after]),
            };
            let candidate = evidence.filter(|evidence| evidence.place.is_some_and(|place| place <= MAX_PLACE));
            let is_turned = fit.is_some_and(|fit| fit.is_turned);
            pairs.extend(candidate.map(|evidence| Pair { before, after, gap_s, evidence, is_turned }));
        }
    }
    // An object without masks is in no pair.
    let nothing = || Piece { span: (FrameId(0), FrameId(0)), times_s: (0.0, 0.0), beginning: None, end: None };
    Ok(Candidates { pieces: pieces.into_iter().map(|piece| piece.unwrap_or_else(nothing)).collect(), pairs })
}

/// Agreement of two pieces over the ground.
fn fit(before: &Piece, after: &Piece, ground: Option<&Ground<'_>>) -> Option<Fit> {
    ground?.fit(before.end.as_ref()?, after.beginning.as_ref()?)
}

/// Evidence of the tracker that two pieces are one object, from the images alone.
fn linked(before: &ObjectTrack, after: &ObjectTrack) -> Option<IdentityEvidence> {
    let link = after.summary.after.filter(|link| link.provisional == before.summary.provisional)?;
    Some(link.evidence)
}

/// `None` for an object without masks.
fn piece(
    run: &Run,
    folder: &Path,
    track: &ObjectTrack,
    index: &BTreeMap<FrameId, usize>,
    ground: Option<&Ground<'_>>,
) -> Result<Option<Piece>> {
    let frames = run.frames()?;
    let seen = track.frames.iter().filter_map(|id| Some((*id, frames[*index.get(id)?].time_s)));
    let seen: Vec<(FrameId, f64)> = seen.collect();
    let (Some(first), Some(last)) = (seen.first(), seen.last()) else { return Ok(None) };
    let end = |from_end: &[(FrameId, f64)]| -> Result<Option<EndMotion>> {
        let mut observations = Vec::new();
        for &(id, time_s) in end_frames(from_end) {
            observations.extend(MaskObservation::of(
                id,
                time_s,
                &super::mask_in(run, folder, track.summary.id, &frames[index[&id]])?,
            ));
        }
        Ok(estimate_end(&observations, ground))
    };
    let reversed: Vec<_> = seen.iter().rev().copied().collect();
    let (beginning, end) = (end(&seen)?, end(&reversed)?);
    Ok(Some(Piece { span: (first.0, last.0), times_s: (first.1, last.1), beginning, end }))
}

/// Features of each view, by piece and frame.
fn view_features(
    run: &Run,
    folder: &Path,
    tracks: &[ObjectTrack],
    candidates: &Candidates,
    outcome: &mut Outcome,
) -> Result<BTreeMap<(usize, FrameId), ViewFeatures>> {
    let views = candidates.views();
    let wanted = views.values().flatten().copied().collect();
    let mut view_features = BTreeMap::new();
    images::for_each(run, Stage::Track, wanted, outcome, |frame, image| {
        for (&piece, _) in views.iter().filter(|(_, frames)| frames.contains(&frame.id)) {
            let mask = super::mask_in(run, folder, tracks[piece].summary.id, &frame)?;
            let features = extract(&image, &mask, &FeatureOptions::object())?;
            view_features.insert((piece, frame.id), ViewFeatures { features, colours: Colors::of(&image, &mask) });
        }
        Ok(())
    })?;
    Ok(view_features)
}

/// Adds the evidence of the views to a pair.
fn compare(
    pair: &Pair,
    pieces: &[Piece],
    view_features: &BTreeMap<(usize, FrameId), ViewFeatures>,
    matching: &MatchOptions,
) -> Pair {
    let (Some(end), Some(beginning)) = (&pieces[pair.before].end, &pieces[pair.after].beginning) else { return *pair };
    let views = |piece: usize, end_motion: &EndMotion| {
        let frames: BTreeSet<FrameId> = frames_of(end_motion).into();
        frames.into_iter().filter_map(|frame| view_features.get(&(piece, frame))).collect::<Vec<_>>()
    };
    let (before, after) = (views(pair.before, end), views(pair.after, beginning));
    let both: Vec<(&ViewFeatures, &ViewFeatures)> =
        before.iter().flat_map(|a| after.iter().map(|b| (*a, *b))).collect();
    let similarity =
        |(a, b): &(&ViewFeatures, &ViewFeatures)| Some(a.colours.as_ref()?.similarity(b.colours.as_ref()?));
    let tolerance_px = TOLERANCE * beginning.observation.side_px().max(end.observation.side_px());
    let colours = both.iter().filter_map(similarity).max_by(f64::total_cmp);
    let points = both.iter().filter_map(|(a, b)| common_points(a, b, tolerance_px, matching)).max();
    let (num_points, num_matches) = points.unzip();
    let colours = colours.or(pair.evidence.colours);
    Pair { evidence: IdentityEvidence { colours, num_points, num_matches, ..pair.evidence }, ..*pair }
}

/// Numbers of points in one arrangement and of all matches; `None` if a view has too few features.
fn common_points(
    a: &ViewFeatures,
    b: &ViewFeatures,
    tolerance_px: f64,
    matching: &MatchOptions,
) -> Option<(usize, usize)> {
    if a.features.len().min(b.features.len()) < MIN_FEATURES {
        return None;
    }
    let at = |features: &Features, k: u32| features.pixels[k as usize].coords.into();
    let matches = match_features(&a.features, &b.features, matching);
    let matches: Vec<_> = matches.iter().map(|[i, j]| (at(&a.features, *i), at(&b.features, *j))).collect();
    Some((consistent_matches(&matches, tolerance_px), matches.len()))
}

/// Merges the pieces of every pair into one object.
fn merge(run: &Run, folder: &Path, tracks: &mut Vec<ObjectTrack>, merged: &[Pair]) -> Result<()> {
    let mut merged = merged.to_vec();
    // Latest first, so that a chain is gathered in its earliest piece.
    merged.sort_by(|a, b| tracks[b.after].summary.first.cmp(&tracks[a.after].summary.first));
    let mut renamed: BTreeMap<ObjectId, ObjectId> = BTreeMap::new();
    let mut absorbed = BTreeSet::new();
    for pair in merged {
        let later = tracks[pair.after].clone();
        let earlier = &mut tracks[pair.before];
        let (from, to) = (later.summary.id, earlier.summary.id);
        move_masks(run, folder, from, to, &later.frames)?;
        atomic::remove_folder(&folder.join(from.to_string()))?;
        renamed.insert(from, to);
        earlier.absorb(later, pair.evidence);
        absorbed.insert(pair.after);
    }
    for track in tracks.iter_mut() {
        for apart in &mut track.apart {
            while let Some(id) = renamed.get(&apart.object) {
                apart.object = *id;
            }
        }
        let own = track.summary.id;
        track.apart.retain(|apart| apart.object != own);
    }
    let mut place = 0..;
    tracks.retain(|_| place.next().is_none_or(|k| !absorbed.contains(&k)));
    Ok(())
}

fn move_masks(run: &Run, folder: &Path, from: ObjectId, to: ObjectId, frames: &[FrameId]) -> Result<()> {
    for frame in run.frames()?.iter().filter(|frame| frames.binary_search(&frame.id).is_ok()) {
        let source = mask_path(folder, from, frame);
        std::fs::rename(&source, mask_path(folder, to, frame)).map_err(IoError::system("rename", &source))?;
    }
    Ok(())
}

impl ObjectTrack {
    /// Appends a later piece.
    fn absorb(&mut self, later: Self, evidence: IdentityEvidence) {
        let (Some(&last), Some(&first)) = (self.frames.last(), later.frames.first()) else { return };
        self.summary = self.summary.merged(&later.summary, Gap { last, first, evidence });
        self.frames.extend(later.frames);
        self.apart.extend(later.apart);
    }
}
