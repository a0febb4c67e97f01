use super::*;
use crate::eval::benchmark::tests::{benchmark, entry};

fn set() -> Benchmark {
    let mut failed = entry("van", "bridge", [None, None, None]);
    failed.warnings = vec!["object 1: no pair".into()];
    let doubted =
        Entry { verdict: Some("no climb".into()), ..entry("van", "crossing", [Some(0.7), Some(0.5), Some(0.5)]) };
    benchmark(vec![entry("smart", "crossing", [Some(0.5), Some(0.1), Some(0.1)]), doubted, failed])
}

#[test]
fn the_summary_counts_what_failed() {
    let text = summary(&set(), &[]);
    assert!(
        text.starts_with("3 sequences, 1 failed. Mean trajectory error as run 0.300 m over 2 of 3, 2.00 times"),
        "{text}"
    );
    assert!(text.contains("1 vehicle rejected; mean over the other 1 of 2: 0.100 m"));
    let row = text.lines().find(|line| line.contains("test: constant-distance")).unwrap();
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    assert_eq!(cells[2..9], ["0.100", "0.500 (1/2)", "0.300", "0.300", "0.500", "0.500", "2 of 3"]);
    let paper = text.lines().find(|line| line.contains("paper: constant-distance")).unwrap();
    assert!(paper.contains("0.312") && paper.contains("35 of 35"), "{paper}");
    // The van's bridge is there in the paper's set, too, though it failed here.
    assert!(text.contains("paper, the same 3: intersection"), "{text}");
}

#[test]
fn every_sequence_has_its_row_and_failures_their_reason() {
    let page = markdown(&set(), &[]);
    let row = page.lines().find(|line| line.starts_with("| bridge_van")).unwrap();
    assert!(row.contains("FAILED: the object cannot be reconstructed") && row.contains("failed |"), "{row}");
    assert!(page.lines().any(|line| line.starts_with("| crossing_van") && line.contains("rejected by the run")));
    let listed: Vec<&str> = page.lines().filter(|line| line.starts_with("- **")).collect();
    assert_eq!(listed.len(), 2, "{listed:?}");
    assert!(listed[0].contains("crossing_van") && listed[0].contains("0.500 m, of which 0.250 m"), "{listed:?}");
    assert!(listed[1].contains("bridge_van") && listed[1].ends_with("warning: object 1: no pair"), "{listed:?}");
}

#[test]
fn reported_sigmas_of_ratios_are_compared_with_the_errors() {
    let mut set = set();
    assert!(!summary(&set, &[]).contains("standard deviations"));
    for (entry, deviation) in set.sequences.iter_mut().zip([0.01, 0.03]) {
        let method = crate::scene::ScaleMethod::Joint;
        let (std, deviation) = (Some(0.04), Some(deviation));
        let scale = crate::eval::ScaleFigures { ratio: 2.0, std, method, degenerate: false, reason: None, deviation };
        entry.scale = Some(scale);
    }
    // Errors of 0.5 and 1.5 standard deviations of 2 %.
    let text = summary(&set, &[]);
    assert!(text.contains("reported standard deviations: RMS 1.12") && text.contains("maximum 1.50"), "{text}");
    let page = markdown(&set, &[]);
    let row = page.lines().find(|line| line.starts_with("| crossing_van")).unwrap();
    assert!(row.contains(" 3.00 | 2.00 |"), "{row}");
}

#[test]
fn the_reconstructions_as_they_were_have_a_floor_of_their_own() {
    let mut set = set();
    assert!(!markdown(&set, &[]).contains("not adjusted"));
    set.sequences[0].floor_as_reconstructed_m = Some(0.07);
    let page = markdown(&set, &[]);
    let cells = |label: &str| -> Vec<String> {
        let row = page.lines().find(|line| line.starts_with("| test:") && line.contains(label)).unwrap();
        row.split('|').map(|cell| cell.trim().to_owned()).collect()
    };
    assert_eq!(cells("at the reference ratio, adjusted")[2..4], ["0.050", "0.250 (1/2)"]);
    assert_eq!(cells("at the reference ratio, as reconstructed")[2..4], ["0.070", "0.250 (1/2)"]);
    let row = page.lines().find(|line| line.starts_with("| crossing_smart")).unwrap();
    assert!(row.contains(" 0.070 "), "{row}");
}

#[test]
fn other_results_are_compared_with_ours() {
    let mut other = set();
    other.label = "COLMAP".into();
    other.sequences.remove(0);
    let page = markdown(&set(), &[other]);
    let head = page.lines().find(|line| line.contains("COLMAP: constant-distance") && line.contains("paper:")).unwrap();
    assert!(head.starts_with("| sequence"), "{head}");
    let rows: Vec<&str> = page.lines().skip_while(|line| *line != head).skip(2).take(3).collect();
    assert!(rows[0].starts_with("| crossing_smart") && rows[0].contains(NONE), "{rows:?}");
    assert!(rows[2].contains("failed"), "{rows:?}");
    assert!(page.contains("COLMAP: as run"));
}

#[test]
fn an_unfinished_benchmark_says_so() {
    let mut set = set();
    set.num_sequences = 35;
    set.left_out = vec!["textures".into()];
    let text = summary(&set, &[]);
    assert!(text.starts_with("UNFINISHED: 3 of 35 sequences are done, 1 failed."), "{text}");
    assert!(text.contains("skipped (no scene.json): textures."));
}
