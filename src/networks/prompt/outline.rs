//! Making one object of what was marked in a box: one part, without holes.

use crate::scene::Mask;

/// The largest part of a mask whose pixels touch at their sides, with its holes filled; empty if the mask is. Of parts
/// of equal size the first one, row by row.
pub(super) fn one_part(mask: &Mask) -> Mask {
    let size = (mask.width(), mask.height());
    let Some(bounds) = mask.bounding_box() else { return Mask::empty(size.0, size.1) };
    let (pixels, width) = (mask.pixels_in(bounds), bounds.width() as usize);
    let parts = parts(&pixels, width);
    let largest = parts.iter().reduce(|best, part| if part.len() > best.len() { part } else { best });
    let mut inside = vec![false; pixels.len()];
    for &pixel in largest.map_or(&[][..], Vec::as_slice) {
        inside[pixel] = true;
    }
    fill_holes(&mut inside, width);
    Mask::from_window(size, bounds, inside)
}

/// Sets what is not set and not connected, side by side, with the border.
fn fill_holes(inside: &mut [bool], width: usize) {
    let outside: Vec<bool> = inside.iter().map(|&set| !set).collect();
    let height = inside.len() / width.max(1);
    let at_border =
        |pixel: usize| [0, width - 1].contains(&(pixel % width)) || [0, height - 1].contains(&(pixel / width));
    for part in parts(&outside, width) {
        if !part.iter().any(|&pixel| at_border(pixel)) {
            part.iter().for_each(|&pixel| inside[pixel] = true);
        }
    }
}

/// The parts of set pixels that touch at their sides, each as pixel numbers; in the order of their first pixels.
fn parts(set: &[bool], width: usize) -> Vec<Vec<usize>> {
    let mut waiting = set.to_vec();
    let mut all = Vec::new();
    for start in 0..set.len() {
        if !waiting[start] {
            continue;
        }
        waiting[start] = false;
        let mut part = vec![start];
        let mut next = 0;
        while next < part.len() {
            for beside in beside(part[next], width, set.len()).into_iter().flatten() {
                if std::mem::take(&mut waiting[beside]) {
                    part.push(beside);
                }
            }
            next += 1;
        }
        all.push(part);
    }
    all
}

/// The up to four pixels that share a side with one.
fn beside(pixel: usize, width: usize, len: usize) -> [Option<usize>; 4] {
    let column = pixel % width;
    [
        (column > 0).then(|| pixel - 1),
        (column + 1 < width).then_some(pixel + 1),
        pixel.checked_sub(width),
        (pixel + width < len).then_some(pixel + width),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(rows: &[&str]) -> Mask {
        let height = rows.len() as u32;
        Mask::from_fn(rows[0].len() as u32, height, |x, y| rows[y as usize].as_bytes()[x as usize] == b'#')
    }

    #[test]
    fn the_largest_part_stays_and_its_holes_are_filled() {
        let mask = drawn(&["#.....#", "..###.#", "..#.#..", "..####.", "......#"]);
        let expected = drawn(&[".......", "..###..", "..###..", "..####.", "......."]);
        assert_eq!(one_part(&mask), expected);
    }

    #[test]
    fn a_bay_is_no_hole_and_nothing_stays_nothing() {
        let bay = drawn(&["###", "#..", "###"]);
        assert_eq!(one_part(&bay), bay);
        assert_eq!(one_part(&Mask::empty(3, 2)), Mask::empty(3, 2));
        assert_eq!(one_part(&Mask::empty(0, 0)), Mask::empty(0, 0));
    }
}
