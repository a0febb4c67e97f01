//! Non-maximum suppression over all views of a frame.

use super::letterbox::Letterbox;
use super::tiles::Tile;

/// Detected box of one view, in frame pixels; `M` is the data from which its family computes the mask.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Candidate<M> {
    /// x0, y0, x1, y1.
    pub(super) corners: [f32; 4],
    pub(super) class_idx: usize,
    pub(super) confidence: f32,
    /// True if it is truncated by a tile's border inside the frame.
    pub(super) cut: bool,
    /// Index of the view of the detection.
    pub(super) view_idx: usize,
    /// Data of its mask.
    pub(super) mask: M,
}

impl<M> Candidate<M> {
    /// Moves the corners from input pixels to frame pixels, clipped to the view.
    pub(super) fn in_frame(mut self, boxed: &Letterbox, view: Tile, view_idx: usize, frame: (u32, u32)) -> Self {
        let [x0, y0] = boxed.frame_from_input(self.corners[0], self.corners[1]);
        let [x1, y1] = boxed.frame_from_input(self.corners[2], self.corners[3]);
        let (left, top) = (view.x0 as f32, view.y0 as f32);
        let (right, bottom) = (left + view.width as f32, top + view.height as f32);
        self.corners = [x0.clamp(left, right), y0.clamp(top, bottom), x1.clamp(left, right), y1.clamp(top, bottom)];
        self.cut = view.cuts(self.corners, frame);
        self.view_idx = view_idx;
        self
    }
}

/// Share of a piece truncated by a tile's border inside another box of its class above which the piece is dropped.
const MAX_PIECE_COVERED: f32 = 0.6;

/// Keeps the best of overlapping boxes of one class: boxes that no tile truncates first, then by score.
///
/// Returns them with the highest score first.
pub(super) fn suppress<M>(mut candidates: Vec<Candidate<M>>, max_iou: f32) -> Vec<Candidate<M>> {
    candidates.sort_by(|a, b| a.cut.cmp(&b.cut).then(b.confidence.total_cmp(&a.confidence)));
    let mut kept: Vec<Candidate<M>> = Vec::new();
    for candidate in candidates {
        let covered = |by: &Candidate<M>| by.class_idx == candidate.class_idx && repeats(&candidate, by, max_iou);
        if !kept.iter().any(covered) {
            kept.push(candidate);
        }
    }
    kept.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    kept
}

/// Returns true if a candidate is a duplicate of a kept one.
fn repeats<M>(candidate: &Candidate<M>, kept: &Candidate<M>, max_iou: f32) -> bool {
    let both = intersection(candidate.corners, kept.corners);
    let (a, b) = (area(candidate.corners), area(kept.corners));
    both > max_iou * (a + b - both) || (candidate.cut && both > MAX_PIECE_COVERED * a)
}

fn area([x0, y0, x1, y1]: [f32; 4]) -> f32 {
    (x1 - x0).max(0.0) * (y1 - y0).max(0.0)
}

fn intersection(a: [f32; 4], b: [f32; 4]) -> f32 {
    area([a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(corners: [f32; 4], class_idx: usize, confidence: f32, cut: bool) -> Candidate<()> {
        Candidate { corners, class_idx, confidence, cut, view_idx: 0, mask: () }
    }

    #[test]
    fn the_best_of_one_class_stays_and_other_classes_do_not_matter() {
        let kept = suppress(
            vec![
                candidate([0.0, 0.0, 10.0, 10.0], 2, 0.5, false),
                candidate([1.0, 0.0, 11.0, 10.0], 2, 0.9, false),
                candidate([0.0, 0.0, 10.0, 10.0], 7, 0.4, false),
                candidate([5.0, 0.0, 15.0, 10.0], 2, 0.3, false),
            ],
            0.6,
        );
        assert_eq!(kept.iter().map(|c| c.confidence).collect::<Vec<_>>(), [0.9, 0.4, 0.3]);
    }

    #[test]
    fn a_truncated_piece_is_suppressed_by_the_whole_object_even_with_a_higher_score() {
        let whole = candidate([0.0, 0.0, 20.0, 10.0], 2, 0.5, false);
        let piece = candidate([0.0, 0.0, 8.0, 10.0], 2, 0.9, true);
        let alone = candidate([50.0, 0.0, 58.0, 10.0], 2, 0.3, true);
        let kept = suppress(vec![piece, whole.clone(), alone.clone()], 0.6);
        assert_eq!(kept, [whole, alone]);
    }
}
