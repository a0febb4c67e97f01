//! Parallel map with an order of results that does not depend on the threads.

/// Results of `work` on every item, in the order of the items.
///
/// On several threads the items are halved recursively: in a loop of many passes over the same items, a thread tends to
/// get the same ones each time, with their data still in its caches.
pub(super) fn in_order<T: Send, R: Send>(parallel: bool, items: Vec<T>, work: impl Fn(T) -> R + Sync) -> Vec<R> {
    if !parallel || items.len() < 2 {
        return items.into_iter().map(work).collect();
    }
    let mut cells: Vec<(Option<T>, Option<R>)> = items.into_iter().map(|item| (Some(item), None)).collect();
    halves(&mut cells, &work);
    cells.into_iter().filter_map(|(_, result)| result).collect()
}

fn halves<T: Send, R: Send>(cells: &mut [(Option<T>, Option<R>)], work: &(impl Fn(T) -> R + Sync)) {
    match cells {
        [] => {}
        [(item, result)] => *result = item.take().map(work),
        _ => {
            let (left, right) = cells.split_at_mut(cells.len() / 2);
            rayon::join(|| halves(left, work), || halves(right, work));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_keep_the_order_of_their_items() {
        for parallel in [false, true] {
            for count in [0, 1, 2, 7, 100] {
                let squares = in_order(parallel, (0..count).collect(), |k: u32| k * k);
                assert_eq!(squares, (0..count).map(|k| k * k).collect::<Vec<_>>());
            }
        }
    }
}
