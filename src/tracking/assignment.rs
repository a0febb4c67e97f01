//! Linear assignment with the maximum total score (Hungarian algorithm).

use pathfinding::kuhn_munkres::kuhn_munkres;
use pathfinding::matrix::Matrix;

/// Assigns rows to columns with the maximum sum of scores; pairs with `None` are forbidden.
///
/// Returns pairs (row, column), ascending by row. Rows and columns may remain unassigned.
pub(super) fn assign(
    num_rows: usize,
    num_columns: usize,
    score: impl Fn(usize, usize) -> Option<f64>,
) -> Vec<(usize, usize)> {
    if num_rows == 0 || num_columns == 0 {
        return Vec::new();
    }
    // The library requires at least as many columns as rows.
    let flip = num_rows > num_columns;
    let (rows, columns) = if flip { (num_columns, num_rows) } else { (num_rows, num_columns) };
    let at = |r: usize, c: usize| if flip { score(c, r) } else { score(r, c) };
    // Integers in units of a millionth: the algorithm requires exact arithmetic.
    let weights: Vec<i64> = (0..rows * columns)
        .map(|i| at(i / columns, i % columns).map_or(0, |s| (s.clamp(0.0, 1e6) * 1e6) as i64 + 1))
        .collect();
    let Ok(matrix) = Matrix::from_vec(rows, columns, weights) else { return Vec::new() };
    let (_, chosen) = kuhn_munkres(&matrix);
    let allowed = chosen.into_iter().enumerate().filter(|&(r, c)| at(r, c).is_some());
    let mut pairs: Vec<(usize, usize)> = allowed.map(|(r, c)| if flip { (c, r) } else { (r, c) }).collect();
    pairs.sort_unstable();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_total_score_is_maximized() {
        let scores = [[0.9, 0.8], [0.8, 0.1]];
        assert_eq!(assign(2, 2, |r, c| Some(scores[r][c])), [(0, 1), (1, 0)]);
    }

    #[test]
    fn surplus_rows_and_columns_remain_unassigned() {
        let score = |r: usize, c: usize| (r + 1 == c).then_some(0.5);
        assert_eq!(assign(3, 2, score), [(0, 1)]);
        assert_eq!(assign(2, 4, score), [(0, 1), (1, 2)]);
        assert_eq!(assign(0, 4, score), []);
        assert_eq!(assign(3, 3, |_, _| None), []);
    }
}
