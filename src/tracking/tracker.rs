//! The tracker: one step per frame.

use ::image::RgbImage;

use super::appearance::Appearance;
use super::assignment::assign;
use super::box_groups::BoxGroup;
use super::boxes::FrameView;
use super::occlusion::Pictures;
use super::propagation::{PreviousObject, background_displacement, carry, carry_whole};
use super::region::Region;
use super::retrace::{Correction, Reported};
use super::track::{Candidate, Moment, Origin, Prediction, Presence, Recognised, Track, compatible, leaves};
use super::{BoxSource, Evidence, FrameInput, IgnoredBoxes, TrackSummary, TrackedMask, TrackerOptions};
use crate::networks::PerceptionError;
use crate::scene::{Detection, Flow, Frame, FrameId, Mask, ObjectId, Rect};

/// A carried mask must keep at least this share of its pixels after nearer objects took theirs.
const MIN_VISIBLE: f64 = 0.3;
/// A detection of which more than this share lies in an object that is already followed starts no track of its own.
pub(super) const MAX_COVERED: f64 = 0.6;

/// Follows objects from frame to frame; see the module.
#[derive(Clone, Debug)]
pub struct Tracker {
    pub(super) options: TrackerOptions,
    pub(super) tracks: Vec<Track>,
    /// Boxes that show nothing that is followed and whose masks nobody asked for yet.
    pub(super) waiting: Vec<BoxGroup>,
    pub(super) num_started: u32,
    finished: Vec<TrackSummary>,
    num_confirmed: u32,
    num_looks: usize,
    pub(super) last_frame: Option<(FrameId, f64, (u32, u32))>,
    /// The picture of the last frame.
    pub(super) last_picture: Option<RgbImage>,
    /// Masks reported for the latest frames.
    pub(super) reported: Reported,
    /// Masks of this frame's objects in earlier frames, carried back from new ones.
    pub(super) retraced: Vec<(FrameId, ObjectId, Region)>,
    corrections: Vec<Correction>,
    pub(super) passed_over: IgnoredBoxes,
}

/// Outcome of a track in the current frame.
pub(super) struct TrackObservation {
    pub(super) track_idx: usize,
    pub(super) evidence: Evidence,
    pub(super) region: Region,
}

impl Tracker {
    /// A tracker that has seen nothing yet.
    pub fn new(options: TrackerOptions) -> Self {
        Self {
            options,
            tracks: Vec::new(),
            waiting: Vec::new(),
            num_started: 0,
            finished: Vec::new(),
            num_confirmed: 0,
            num_looks: 0,
            last_frame: None,
            last_picture: None,
            reported: Reported::default(),
            retraced: Vec::new(),
            corrections: Vec::new(),
            passed_over: IgnoredBoxes::default(),
        }
    }

    /// Takes the next frame.
    ///
    /// * `image` – the frame's pixels, for appearance.
    /// * `look` – what was found in it.
    /// * `flow` – from the frame given before to this one; without it objects are followed by their velocity alone.
    ///
    /// Returns the masks of this frame, ascending by provisional id; they do not overlap.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] if image, masks and flow differ in size, [`PerceptionError::FrameOrder`] if
    /// the frame is not later than the last one; whatever the prompter runs into.
    pub fn advance(
        &mut self,
        frame: &Frame,
        image: &RgbImage,
        look: FrameInput<'_>,
        flow: Option<&Flow>,
    ) -> Result<Vec<TrackedMask>, PerceptionError> {
        let elapsed_s = self.check(frame, image, &look, flow)?;
        let now = Moment { count: self.num_looks, frame: frame.id, time_s: frame.time_s };
        let view = FrameView { image, flow, now, elapsed_s };
        let by = match look {
            FrameInput::NotLooked => None,
            FrameInput::Masks(_) => Some(BoxSource::Detector),
            FrameInput::Boxes { by, .. } => Some(by),
        };
        if let Some(by) = by {
            self.num_looks += 1;
            self.tracks.iter_mut().for_each(|track| track.look(by));
        }
        let sightings = match look {
            FrameInput::Masks(detections) => self.follow_masks(&view, detections),
            FrameInput::Boxes { found, prompter, .. } => self.follow_boxes(&view, found, prompter)?,
            FrameInput::NotLooked => self.follow_boxes(&view, Vec::new(), None)?,
        };
        let masks = self.report(sightings, frame.id, Vec::new(), image.dimensions());
        self.settle(now, image.dimensions());
        self.last_frame = Some((frame.id, frame.time_s, image.dimensions()));
        self.last_picture = Some(image.clone());
        Ok(masks)
    }

    /// Follows all tracks into a frame of which masks are known.
    fn follow_masks(&mut self, view: &FrameView, detections: Vec<Detection>) -> Vec<TrackObservation> {
        let FrameView { image, flow, now, elapsed_s } = *view;
        let candidates = self.candidates(image, detections);
        let predictions = self.predict(&candidates, flow, image, elapsed_s);
        let (pairs, left) = self.associate(&candidates, &predictions, now);

        let mut sightings = Vec::new();
        for &(track_idx, candidate_idx) in &pairs {
            let candidate = &candidates[candidate_idx];
            self.note_gap(track_idx, &candidate.region, candidate.appearance.as_ref(), now);
            self.tracks[track_idx].detect(candidate, &predictions[track_idx], now, elapsed_s);
            let evidence = Evidence::Detected { confidence: candidate.confidence };
            sightings.push(TrackObservation { track_idx, evidence, region: candidate.region.clone() });
        }
        sightings.extend(self.start_tracks(&candidates, &left, &sightings, now));
        let unseen: Vec<usize> = (0..predictions.len()).filter(|t| !pairs.iter().any(|p| p.0 == *t)).collect();
        let carried = self.carry_on(&unseen, &predictions, &sightings, image, now, elapsed_s);
        sightings.extend(carried);
        sightings
    }

    /// The places in which flow is of use: those of all that is followed or waits.
    pub fn places(&self) -> Vec<Rect> {
        let followed = self.tracks.iter().map(|track| track.whole.rect());
        followed.chain(self.waiting.iter().map(|sight| sight.rect)).collect()
    }

    /// Masks of earlier frames that are better known since the last call; they take the place of those reported then.
    pub fn take_corrections(&mut self) -> Vec<Correction> {
        std::mem::take(&mut self.corrections)
    }

    /// Stationary objects that were not followed so far.
    pub fn passed_over(&self) -> IgnoredBoxes {
        self.passed_over
    }

    /// Ends all tracks. Returns the confirmed ones, ascending by lasting id.
    pub fn finish(mut self) -> Vec<TrackSummary> {
        self.finished.extend(self.tracks.iter().filter_map(Track::summary));
        self.finished.sort_by_key(|summary| summary.id);
        self.finished
    }

    /// Checks order and sizes; gives the seconds since the last frame, 0 for the first.
    fn check(
        &self,
        frame: &Frame,
        image: &RgbImage,
        look: &FrameInput<'_>,
        flow: Option<&Flow>,
    ) -> Result<f64, PerceptionError> {
        self.check_sizes(frame, image, look, flow)?;
        match self.last_frame {
            Some((previous, ..)) if frame.id <= previous => {
                Err(PerceptionError::FrameOrder { previous, found: frame.id })
            }
            Some((_, time_s, _)) => Ok((frame.time_s - time_s).max(0.0)),
            None => Ok(0.0),
        }
    }

    pub(super) fn check_sizes(
        &self,
        frame: &Frame,
        image: &RgbImage,
        look: &FrameInput<'_>,
        flow: Option<&Flow>,
    ) -> Result<(), PerceptionError> {
        self.options.check()?;
        self.same_size("the image", frame, image, image.dimensions())?;
        let detections = if let FrameInput::Masks(detections) = look { detections.as_slice() } else { &[] };
        for detection in detections {
            self.same_size("a detected mask", frame, image, (detection.mask.width(), detection.mask.height()))?;
        }
        flow.map_or(Ok(()), |flow| self.same_size("the flow", frame, image, (flow.width, flow.height)))
    }

    /// Refuses what has not the size of the frames, which is that of the first one.
    pub(super) fn same_size(
        &self,
        what: &str,
        frame: &Frame,
        image: &RgbImage,
        found: (u32, u32),
    ) -> Result<(), PerceptionError> {
        let expected = self.last_frame.map_or(image.dimensions(), |(_, _, size)| size);
        if found == expected {
            return Ok(());
        }
        Err(PerceptionError::SizeMismatch { what: format!("{what} of {}", frame.name), expected, found })
    }

    /// The detections that count: of a tracked class, large enough, each object once.
    fn candidates(&self, image: &RgbImage, mut detections: Vec<Detection>) -> Vec<Candidate> {
        detections.retain(|d| self.options.track_classes.contains(&d.class));
        detections.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        let mut kept: Vec<Candidate> = Vec::new();
        for Detection { class, confidence, mask } in detections {
            let Some(region) = Region::from_mask(&mask) else { continue };
            let limit = self.options.duplicate_overlap;
            let same = |k: &Candidate| {
                compatible(&k.class, &class) && region.covered_by(&k.region).max(k.region.covered_by(&region)) > limit
            };
            if region.area() >= self.options.min_area_px2 && !kept.iter().any(same) {
                let appearance = Appearance::of(image, &region);
                kept.push(Candidate { class, confidence, region, appearance });
            }
        }
        kept
    }

    /// Where each track should be now.
    pub(super) fn predict(
        &self,
        candidates: &[Candidate],
        flow: Option<&Flow>,
        image: &RgbImage,
        elapsed_s: f64,
    ) -> Vec<Prediction> {
        let size = image.dimensions();
        let pictures = self.last_picture.as_ref().map(|before| Pictures { before, now: image });
        let mut occupied = Mask::empty(size.0, size.1);
        let regions = self.tracks.iter().map(|t| &t.region).chain(candidates.iter().map(|c| &c.region));
        for (x, y) in regions.flat_map(Region::iter) {
            occupied.set(x, y, true);
        }
        let predict_one = |track: &Track| {
            let background = flow.and_then(|f| background_displacement(f, track.region.bounds(), &occupied));
            let background = background.unwrap_or_default();
            let is_seen = !matches!(track.presence, Presence::Lost(_));
            let carried = flow.filter(|_| is_seen).and_then(|f| match track.origin() {
                Origin::Masks => carry(&track.region, f),
                Origin::Boxes => {
                    let seen = PreviousObject { region: &track.region, whole: &track.whole, cover: &track.cover };
                    carry_whole(&seen, f, pictures)
                }
            });
            let moved = track.whole.moved(track.expected(background, elapsed_s), size.0, size.1);
            Prediction { carried, moved, background }
        };
        self.tracks.iter().map(predict_one).collect()
    }

    /// Pairs (track, candidate) and the candidates left over. Tracks in sight go first, by overlap; then the others, by
    /// place and appearance.
    fn associate(
        &self,
        candidates: &[Candidate],
        predictions: &[Prediction],
        now: Moment,
    ) -> (Vec<(usize, usize)>, Vec<usize>) {
        let fits = |t: usize, c: usize| compatible(self.tracks[t].class(), &candidates[c].class);
        let in_sight: Vec<usize> =
            (0..self.tracks.len()).filter(|&t| !matches!(self.tracks[t].presence, Presence::Lost(_))).collect();
        let mut pairs: Vec<(usize, usize)> = assign(in_sight.len(), candidates.len(), |row, c| {
            let overlap = predictions[in_sight[row]].overlap(&candidates[c].region);
            (fits(in_sight[row], c) && overlap >= self.options.min_overlap).then_some(overlap)
        })
        .into_iter()
        .map(|(row, c)| (in_sight[row], c))
        .collect();
        let free = |pairs: &[(usize, usize)]| -> Vec<usize> {
            (0..candidates.len()).filter(|c| !pairs.iter().any(|p| p.1 == *c)).collect()
        };
        let columns = free(&pairs);
        let is_free = |t: &usize| {
            !pairs.iter().any(|p| p.0 == *t) && (!self.tracks[*t].is_lost() || self.tracks[*t].is_briefly_lost(now))
        };
        let rows: Vec<usize> = (0..self.tracks.len()).filter(is_free).collect();
        let found_again = assign(rows.len(), columns.len(), |row, column| {
            let (track, candidate) = (&self.tracks[rows[row]], &candidates[columns[column]]);
            let (region, appearance) = (&candidate.region, candidate.appearance.as_ref());
            let recognised = track.recognise(region, appearance, now, self.options.min_similarity)?;
            fits(rows[row], columns[column]).then_some(recognised.score)
        });
        pairs.extend(found_again.into_iter().map(|(row, column)| (rows[row], columns[column])));
        pairs.sort_unstable();
        let left = free(&pairs);
        (pairs, left)
    }

    /// Starts tracks from sure detections that no followed object explains.
    fn start_tracks(
        &mut self,
        candidates: &[Candidate],
        left: &[usize],
        seen: &[TrackObservation],
        now: Moment,
    ) -> Vec<TrackObservation> {
        let mut started = Vec::new();
        for candidate in left.iter().map(|&c| &candidates[c]) {
            let explained = seen.iter().any(|s| candidate.region.covered_by(&s.region) > MAX_COVERED);
            if candidate.confidence < self.options.start_confidence || explained {
                continue;
            }
            self.num_started += 1;
            let track = Track::start(ObjectId(self.num_started), candidate, now);
            self.add(track, candidate.appearance.as_ref(), now);
            let evidence = Evidence::Detected { confidence: candidate.confidence };
            started.push(TrackObservation {
                track_idx: self.tracks.len() - 1,
                evidence,
                region: candidate.region.clone(),
            });
        }
        started
    }

    /// Remembers that a track which is about to be found again was lost.
    pub(super) fn note_gap(&mut self, track_idx: usize, region: &Region, appearance: Option<&Appearance>, now: Moment) {
        let track = &mut self.tracks[track_idx];
        let recognised = track.recognise(region, appearance, now, self.options.min_similarity);
        if let Some(recognised) = recognised.filter(|_| track.is_lost()) {
            track.remember_gap(recognised.evidence, now);
        }
    }

    /// Adds a new track; where a lost object may have come up again, it remembers which.
    pub(super) fn add(&mut self, mut track: Track, appearance: Option<&Appearance>, now: Moment) {
        let recognised = |lost: &Track| {
            let may_be = lost.may_be_succeeded(now) && lost.may_be(Some(track.class()));
            let found = lost.recognise(&track.region, appearance, now, self.options.min_similarity);
            found.filter(|_| may_be)
        };
        let lost = self.tracks.iter().enumerate().filter_map(|(idx, lost)| Some((idx, recognised(lost)?)));
        let best = lost.max_by(|a, b| a.1.score.total_cmp(&b.1.score).then(b.0.cmp(&a.0)));
        if let Some((idx, Recognised { evidence, .. })) = best {
            track.follow_after(&mut self.tracks[idx], evidence);
        }
        self.tracks.push(track);
    }

    /// Continues the tracks without a detection: by their carried mask where it can be trusted, else as lost.
    fn carry_on(
        &mut self,
        unseen: &[usize],
        predictions: &[Prediction],
        seen: &[TrackObservation],
        image: &RgbImage,
        now: Moment,
        elapsed_s: f64,
    ) -> Vec<TrackObservation> {
        let mut carried_on = Vec::new();
        for &track_idx in unseen {
            let prediction = &predictions[track_idx];
            let track = &mut self.tracks[track_idx];
            let trusted = prediction.carried.as_ref().filter(|c| {
                let hidden: f64 = seen.iter().map(|s| c.region.covered_by(&s.region)).sum();
                let worn_out = matches!(track.presence, Presence::Carried(n) if n >= self.options.max_carried);
                let looks_right = match (&track.appearance, Appearance::of(image, &c.region)) {
                    (Some(before), Some(now)) => before.similarity(&now) >= self.options.min_similarity,
                    _ => true,
                };
                !worn_out && c.share >= self.options.min_carried_share && hidden < 1.0 - MIN_VISIBLE && looks_right
            });
            if let Some(carried) = trusted {
                track.count_unboxed(false);
                track.carry(carried, prediction.background, elapsed_s);
                carried_on.push(TrackObservation {
                    track_idx,
                    evidence: Evidence::Carried,
                    region: carried.region.clone(),
                });
            } else {
                let moved = prediction.moved.clone().unwrap_or_else(|| track.region.clone());
                track.lose(moved, now);
            }
        }
        carried_on
    }

    /// The masks of the frame: each pixel goes to one object, to a detected one before a prompted one before a carried
    /// one, and to the surer first. Masks that were carried back to earlier frames become corrections.
    ///
    /// * `known` – what else has pixels in the frame.
    pub(super) fn report(
        &mut self,
        mut sightings: Vec<TrackObservation>,
        frame: FrameId,
        known: Vec<(ObjectId, Region)>,
        (width, height): (u32, u32),
    ) -> Vec<TrackedMask> {
        let rank = |s: &TrackObservation| match s.evidence {
            Evidence::Detected { confidence } => confidence,
            Evidence::Prompted { quality } => quality - 1.0,
            Evidence::Carried => -1.0,
        };
        sightings.sort_by(|a, b| rank(b).total_cmp(&rank(a)).then(a.track_idx.cmp(&b.track_idx)));
        let mut taken = Mask::empty(width, height);
        let mut masks = Vec::with_capacity(sightings.len());
        let mut reported = known;
        for sighting in sightings {
            let free = |x: u32, y: u32| !taken.get(i64::from(x), i64::from(y));
            let Some(region) = sighting.region.filtered(free) else { continue };
            let mask = region.to_mask(width, height);
            taken.union_with(&mask);
            let object = self.tracks[sighting.track_idx].provisional;
            reported.push((object, region));
            masks.push(TrackedMask { object, mask, evidence: sighting.evidence });
        }
        masks.sort_by_key(|m| m.object);
        self.reported.remember(frame, reported);
        for (frame, object, region) in std::mem::take(&mut self.retraced) {
            self.corrections.extend(self.reported.correct(frame, object, &region, (width, height)));
        }
        masks
    }

    /// Gives lasting ids and ends what is over.
    fn settle(&mut self, now: Moment, (width, height): (u32, u32)) {
        for track in &mut self.tracks {
            if track.earns_id(&self.options) {
                self.num_confirmed += 1;
                track.id = Some(ObjectId(self.num_confirmed));
            }
        }
        let (options, finished) = (&self.options, &mut self.finished);
        self.tracks.retain(|track| {
            let gone =
                matches!(track.presence, Presence::Lost(_)) && leaves(track.region.bounds(), [0.0; 2], width, height);
            let over = gone || track.is_over(now, options);
            if over {
                finished.extend(track.summary());
            }
            !over
        });
    }
}
