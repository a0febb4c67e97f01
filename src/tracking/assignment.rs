//! Who is who: the assignment with the greatest total overlap (Hungarian algorithm).

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;

/// Assigns rows to columns so that the sum of scores is greatest; pairs with `None` never meet.
///
/// Returns pairs (row, column), ascending by row. Rows and columns may be left over.
pub(super) fn assign(
    num_rows: usize,
    num_columns: usize,
    score: impl Fn(usize, usize) -> Option<f64>,
) -> Vec<(usize, usize)> {
    if num_rows == 0 || num_columns == 0 {
        return Vec::new();
    }
    // The library wants at least as many columns as rows.
    let flip = num_rows > num_columns;
    let (rows, columns) = if flip { (num_columns, num_rows) } else { (num_rows, num_columns) };
    let at = |r: usize, c: usize| if flip { score(c, r) } else { score(r, c) };
    // Integers of a millionth, as the algorithm wants exact arithmetic.
    let weights: Vec<i64> = (0..rows * columns)
        .map(|i| at(i / columns, i % columns).map_or(0, |s| (s.clamp(0.0, 1e6) * 1e6) as i64 + 1))
        .collect();
    let Ok(matrix) = Matrix::from_vec(rows, columns, weights) else { return Vec::new() };
    let (_, chosen) = kuhn_munkres(&matrix);
    let met = chosen.into_iter().enumerate().filter(|&(r, c)| at(r, c).is_some());
    let mut pairs: Vec<(usize, usize)> = met.map(|(r, c)| if flip { (c, r) } else { (r, c) }).collect();
    pairs.sort_unstable();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_total_counts_not_the_single_best() {
        let scores = [[0.9, 0.8], [0.8, 0.1]];
        assert_eq!(assign(2, 2, |r, c| Some(scores[r][c])), [(0, 1), (1, 0)]);
    }

    #[test]
    fn left_over_rows_and_columns_stay_alone() {
        let score = |r: usize, c: usize| (r + 1 == c).then_some(0.5);
        assert_eq!(assign(3, 2, score), [(0, 1)]);
        assert_eq!(assign(2, 4, score), [(0, 1), (1, 2)]);
        assert_eq!(assign(0, 4, score), []);
        assert_eq!(assign(3, 3, |_, _| None), []);
    }
}
