//! Largest connected component of a mask, without holes.

use crate::scene::Mask;

/// Returns the largest 4-connected component of a mask, with its holes filled; empty if the mask is empty.
///
/// Of components of equal size it is the first, row by row.
pub(super) fn largest_component(mask: &Mask) -> Mask {
    let size = (mask.width(), mask.height());
    let Some(bounds) = mask.bounding_box() else { return Mask::empty(size.0, size.1) };
    let (pixels, width) = (mask.pixels_in(bounds), bounds.width() as usize);
    let components = components(&pixels, width);
    let largest =
        components.iter().reduce(|best, component| if component.len() > best.len() { component } else { best });
    let mut inside = vec![false; pixels.len()];
    for &pixel in largest.map_or(&[][..], Vec::as_slice) {
        inside[pixel] = true;
    }
    fill_holes(&mut inside, width);
    Mask::from_window(size, bounds, inside)
}

/// Sets all pixels that are not 4-connected with the border through unset pixels.
fn fill_holes(inside: &mut [bool], width: usize) {
    let outside: Vec<bool> = inside.iter().map(|&set| !set).collect();
    let height = inside.len() / width.max(1);
    let at_border =
        |pixel: usize| [0, width - 1].contains(&(pixel % width)) || [0, height - 1].contains(&(pixel / width));
    for component in components(&outside, width) {
        if !component.iter().any(|&pixel| at_border(pixel)) {
            component.iter().for_each(|&pixel| inside[pixel] = true);
        }
    }
}

/// 4-connected components of set pixels, as pixel indices, in the order of their first pixels.
fn components(set: &[bool], width: usize) -> Vec<Vec<usize>> {
    let mut pending = set.to_vec();
    let mut all = Vec::new();
    for start in 0..set.len() {
        if !pending[start] {
            continue;
        }
        pending[start] = false;
        let mut component = vec![start];
        let mut next = 0;
        while next < component.len() {
            for neighbor in neighbors(component[next], width, set.len()).into_iter().flatten() {
                if std::mem::take(&mut pending[neighbor]) {
                    component.push(neighbor);
                }
            }
            next += 1;
        }
        all.push(component);
    }
    all
}

/// Up to four pixels that share a side with a pixel.
fn neighbors(pixel: usize, width: usize, len: usize) -> [Option<usize>; 4] {
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
    fn the_largest_component_is_kept_and_its_holes_are_filled() {
        let mask = drawn(&["#.....#", "..###.#", "..#.#..", "..####.", "......#"]);
        let expected = drawn(&[".......", "..###..", "..###..", "..####.", "......."]);
        assert_eq!(largest_component(&mask), expected);
    }

    #[test]
    fn a_bay_is_no_hole_and_an_empty_mask_stays_empty() {
        let bay = drawn(&["###", "#..", "###"]);
        assert_eq!(largest_component(&bay), bay);
        assert_eq!(largest_component(&Mask::empty(3, 2)), Mask::empty(3, 2));
        assert_eq!(largest_component(&Mask::empty(0, 0)), Mask::empty(0, 0));
    }
}
