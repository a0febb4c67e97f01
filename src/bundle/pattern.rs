//! Block sparsity pattern of the reduced system.

use super::layout::{Layout, NONE, counting_sort};

/// Number of views up to which every pair gets a block, and no pattern is computed.
const ALL_PAIRS_LIMIT: usize = 64;

/// Minimum fraction of the envelope occupied by blocks for a band in the given order, which no other order improves.
const BAND_FILL: f64 = 0.5;
/// The same if anchors form a border behind the band: part of that border is empty.
const BORDERED_FILL: f64 = 0.25;

/// Pairs of views that have a block.
pub(super) struct Pattern {
    /// First block of each panel, and the end of the last.
    pub start: Vec<usize>,
    /// Row (first view of the pair) of every block, ascending within a panel; the diagonal block is last.
    pub rows: Vec<u32>,
    /// Smallest row of each panel.
    first_row: Vec<u32>,
    /// Start of each panel's part of `place`.
    place_start: Vec<usize>,
    /// Index within its panel of the block of each row from `first_row`, or [`NONE`].
    place: Vec<u32>,
    /// Minimum fraction of the envelope occupied by blocks if the views form a band.
    least_fill: f64,
    /// True if there are no pairs of different views, whatever the points are.
    of_single_views: bool,
}

impl Pattern {
    pub fn new(layout: &Layout) -> Self {
        if layout.num_blocks() <= ALL_PAIRS_LIMIT { Self::all_pairs(layout.num_blocks()) } else { Self::seen(layout) }
    }

    /// Diagonal blocks only, for a system that is not formed.
    pub fn of_single_views(n: usize) -> Self {
        Self {
            start: (0..=n).collect(),
            rows: (0..n as u32).collect(),
            first_row: (0..n as u32).collect(),
            place_start: (0..n).collect(),
            place: vec![0; n],
            least_fill: BAND_FILL,
            of_single_views: true,
        }
    }

    fn all_pairs(n: usize) -> Self {
        Self {
            start: (0..=n).map(|j| j * (j + 1) / 2).collect(),
            rows: (0..n as u32).flat_map(|j| 0..=j).collect(),
            first_row: vec![0; n],
            place_start: vec![0; n],
            place: (0..n as u32).collect(),
            least_fill: BAND_FILL,
            of_single_views: false,
        }
    }

    /// Marks the pairs of every point in the envelope of the matrix.
    fn seen(layout: &Layout) -> Self {
        let n = layout.num_blocks();
        let first_row = layout.first_rows();
        let widths = || first_row.iter().enumerate().map(|(j, first)| j + 1 - *first as usize);
        let place_start = widths().scan(0, |end, width| Some(std::mem::replace(end, *end + width))).collect();
        let least_fill = if layout.pose_of_block.is_sorted() { BAND_FILL } else { BORDERED_FILL };
        let place = vec![NONE; widths().sum()];
        let (start, rows) = (vec![0], Vec::new());
        let mut pattern = Self { start, rows, first_row, place_start, place, least_fill, of_single_views: false };
        let blocks_of = |point| layout.blocks_of_point(point).iter().map(move |block| (*block as usize, point as u32));
        let (points, start) = counting_sort((0..layout.points.len()).flat_map(blocks_of), n);
        for j in 0..n {
            pattern.mark_panel(layout, j, &points[start[j] as usize..start[j + 1] as usize]);
        }
        pattern
    }

    /// Marks the views that observe the points of view j.
    fn mark_panel(&mut self, layout: &Layout, j: usize, points: &[u32]) {
        let first = self.first_row[j] as usize;
        let place = &mut self.place[self.place_start[j]..][..j + 1 - first];
        place[j - first] = 0;
        for point in points {
            // Sorted by view block, observations without one last.
            let views = &layout.obs_block[layout.obs_of_point(*point as usize)];
            for i in views.iter().take_while(|i| **i as usize <= j) {
                place[*i as usize - first] = 0;
            }
        }
        let marked = place.iter_mut().enumerate().filter(|(_, cell)| **cell != NONE);
        for (count, (row, cell)) in (0..).zip(marked) {
            *cell = count;
            self.rows.push((first + row) as u32);
        }
        self.start.push(self.rows.len());
    }

    /// The first view that observes a common point with view j, or j.
    pub fn first_row(&self, j: usize) -> usize {
        self.first_row[j] as usize
    }

    /// Blocks of panel j.
    pub fn panel(&self, j: usize) -> std::ops::Range<usize> {
        self.start[j]..self.start[j + 1]
    }

    /// Index of block (i, j), i ≤ j, if there is one.
    pub fn find(&self, i: usize, j: usize) -> Option<usize> {
        let row = i.checked_sub(self.first_row[j] as usize)?;
        let place = self.place[self.place_start[j] + row];
        (place != NONE).then(|| self.start[j] + place as usize)
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Number of blocks in the envelope: from the first of each panel to its diagonal.
    pub fn envelope(&self) -> usize {
        self.first_row.iter().enumerate().map(|(j, first)| j + 1 - *first as usize).sum()
    }

    /// Returns true if there are no pairs of different views, whatever the points are.
    pub fn is_of_single_views(&self) -> bool {
        self.of_single_views
    }

    /// Returns true if the views form a band in the given order, as those of a video do.
    pub fn is_band(&self) -> bool {
        self.len() as f64 >= self.least_fill * self.envelope() as f64
    }

    /// Index of block (i, j), i ≤ j, of two views that observe a common point.
    #[inline(always)]
    pub fn place(&self, i: usize, j: usize) -> usize {
        self.start[j] + self.place[self.place_start[j] + i - self.first_row[j] as usize] as usize
    }
}
