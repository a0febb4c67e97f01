//! Sorting of fixes by time, robust to clock jumps.

use std::cmp::Ordering;

use super::fix::{Fix, Log};

/// Returns the time used for ordering: video time if all fixes have one, otherwise clock time.
fn time_of(fixes: &[Fix]) -> impl Fn(&Fix) -> Option<f64> + Copy + use<> {
    let by_video = fixes.iter().all(|fix| fix.video_s.is_some());
    move |fix| if by_video { fix.video_s } else { fix.clock_s }
}

/// Sorts fixes that are in another order in the file, such as newest first or tracks in any order.
///
/// Ascending series that do not overlap are tracks and are sorted. Where they overlap, single times are wrong or the
/// clock was set, and [`keep_rising`] decides.
pub(super) fn sort_by_time(log: &mut Log) {
    let time_s = time_of(&log.fixes);
    let times: Option<Vec<f64>> = log.fixes.iter().map(time_s).collect();
    let Some(times) = times else { return };
    let num_falling = times.windows(2).filter(|pair| pair[1] < pair[0]).count();
    if num_falling == 0 {
        return;
    }
    let mut fixes = log.fixes.clone();
    if 2 * num_falling > times.len() {
        fixes.reverse();
    }
    let first_s = |run: &[Fix]| run.first().and_then(time_s);
    let mut runs: Vec<&[Fix]> = fixes.chunk_by(|a, b| time_s(a) <= time_s(b)).collect();
    runs.sort_by(|a, b| first_s(a).partial_cmp(&first_s(b)).unwrap_or(Ordering::Equal));
    let is_apart = |pair: &[&[Fix]]| pair[0].last().and_then(time_s) <= first_s(pair[1]);
    if runs.windows(2).all(is_apart) {
        log.fixes = runs.concat();
    }
}

/// Keeps the longest series of fixes with ascending times and skips all others.
///
/// A single wrong time removes one fix; a clock set in mid-flight removes the shorter side. Logs whose fixes have no
/// time are unchanged.
pub(super) fn keep_rising(log: &mut Log) {
    let fixes = std::mem::take(&mut log.fixes);
    let times: Vec<Option<f64>> = fixes.iter().map(time_of(&fixes)).collect();
    if times.iter().all(Option::is_none) {
        log.fixes = fixes;
        return;
    }
    let keep = longest_rise(&times);
    let mut last_s = None;
    for ((fix, time), keep) in fixes.into_iter().zip(times).zip(keep) {
        if keep {
            last_s = time;
            log.fixes.push(fix);
        } else {
            log.skip_line(fix.line, reason(time, last_s));
        }
    }
    log.passed_over.sort_by_key(|passed| passed.line);
}

fn reason(time_s: Option<f64>, last_s: Option<f64>) -> String {
    match (time_s, last_s) {
        (None, _) => "fix without time, others have one".to_owned(),
        (Some(time), Some(last)) if time == last => "second fix of the same time".to_owned(),
        (Some(time), Some(last)) if time < last => format!("clock goes back by {:.3} s", last - time),
        _ => "clock jumps ahead of the following fixes".to_owned(),
    }
}

/// Marks a longest strictly rising series (patience sorting: for each length, the series that ends earliest).
fn longest_rise(times: &[Option<f64>]) -> Vec<bool> {
    let mut tails: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = vec![None; times.len()];
    for (i, time) in times.iter().enumerate() {
        let Some(time) = time else { continue };
        let length = tails.partition_point(|&tail| times[tail].is_some_and(|last| last < *time));
        before[i] = length.checked_sub(1).map(|shorter| tails[shorter]);
        match tails.get_mut(length) {
            // Of equal times the first one is kept.
            Some(tail) if times[*tail] == times[i] => {}
            Some(tail) => *tail = i,
            None => tails.push(i),
        }
    }
    let mut keep = vec![false; times.len()];
    let mut next = tails.last().copied();
    while let Some(i) = next {
        keep[i] = true;
        next = before[i];
    }
    keep
}

#[cfg(test)]
mod tests {
    use super::super::fix::Position;
    use super::*;

    fn sorted(times: &[f64]) -> Vec<f64> {
        let position = Position { longitude_deg: 1.0, latitude_deg: 1.0, resolution_deg: 1e-6 };
        let fixes = times.iter().map(|time| Fix { clock_s: Some(*time), ..Fix::at(1, position) }).collect();
        let mut log = Log { fixes, ..Log::default() };
        sort_by_time(&mut log);
        log.fixes.iter().map(|fix| fix.clock_s.unwrap()).collect()
    }

    #[test]
    fn whole_tracks_are_sorted_and_wrong_times_are_not() {
        assert_eq!(sorted(&[4.0, 3.0, 2.0, 2.0, 1.0]), [1.0, 2.0, 2.0, 3.0, 4.0]);
        assert_eq!(sorted(&[7.0, 8.0, 9.0, 4.0, 5.0, 1.0, 2.0]), [1.0, 2.0, 4.0, 5.0, 7.0, 8.0, 9.0]);
        assert_eq!(sorted(&[1.0, 2.0, 900.0, 3.0, 4.0]), [1.0, 2.0, 900.0, 3.0, 4.0]);
        assert_eq!(sorted(&[]), [0.0; 0]);
    }

    fn kept(times: &[f64]) -> Vec<f64> {
        let times: Vec<Option<f64>> = times.iter().copied().map(Some).collect();
        let keep = longest_rise(&times);
        times.iter().zip(keep).filter(|(_, keep)| *keep).filter_map(|(time, _)| *time).collect()
    }

    #[test]
    fn one_wrong_time_costs_one_fix() {
        assert_eq!(kept(&[1.0, 2.0, 900.0, 3.0, 4.0]), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(kept(&[1.0, 2.0, -5.0, 3.0, 3.0, 4.0]), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(kept(&[]), [0.0; 0]);
    }

    #[test]
    fn a_clock_that_was_set_costs_the_shorter_side() {
        assert_eq!(kept(&[50.0, 51.0, 1.0, 2.0, 3.0, 4.0]), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(kept(&[5.0, 6.0, 7.0, 1.0, 2.0]), [5.0, 6.0, 7.0]);
    }
}
