//! Charts over the images, and distributions of errors and track lengths.

use crate::eval::comparison::{Against, Comparison, ERROR_BIN_PX, ImageDifference, ModelFigures, NUM_ERROR_BINS};
use crate::report::chart::{Chart, Drawing, Line};
use crate::report::comparison::{Data, colour, units};
use crate::report::ticks::{ticks, whole_ticks};

/// Charts over the images of the reference, in the order of their names.
pub(super) fn charts(data: &Data) -> Vec<Drawing> {
    let comparison = data.comparison;
    let mut names: Vec<&str> = data.models[0].images.values().map(|image| image.name.as_str()).collect();
    names.sort_unstable();
    let place = |name: &str| names.binary_search(&name).ok().map(|k| k as f64);
    let line = |(k, other): (usize, &Against), value: &dyn Fn(&ImageDifference) -> Option<f64>| {
        let mut points: Vec<(f64, f64)> =
            other.images.iter().filter_map(|image| Some((place(&image.name)?, value(image)?))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Few images are drawn as dots.
        let (label, colour) = (other.subject.name.clone(), colour(k + 1).to_owned());
        Line { label, colour, points, dots: names.len() < 60, ..Line::default() }
    };
    let of_others = |value: &dyn Fn(&ImageDifference) -> Option<f64>| {
        comparison.others.iter().enumerate().map(|other| line(other, value)).collect::<Vec<_>>()
    };
    let mut errors = of_others(&|image| image.error_px[1]);
    if let Some(first) = comparison.others.first() {
        let own = line((0, first), &|image| image.error_px[0]);
        errors.insert(0, Line { label: comparison.reference.name.clone(), colour: colour(0).into(), ..own });
    }
    let caption = "Over the images of the first, ordered by name.";
    let chart = |title: &str, unit: &str, lines| Chart {
        title: title.into(),
        caption: caption.into(),
        unit: unit.into(),
        lines,
        from_zero: true,
        ..Chart::default()
    };
    let end = names.len().saturating_sub(1).max(1) as f64;
    [
        chart("Distance of the centers", units(comparison.unit)[0], of_others(&|image| image.center)),
        chart("Angle between the cameras", "°", of_others(&|image| image.rotation_deg)),
        chart("Reprojection error, mean of each image", "px", errors),
    ]
    .iter()
    .filter_map(|chart| chart.draw_over((0.0, end), whole_ticks((0.0, end))))
    .collect()
}

/// Names, figures and colors of all reconstructions of a comparison.
pub(super) fn sides(comparison: &Comparison) -> Vec<(&str, &ModelFigures, &'static str)> {
    let subjects = std::iter::once(&comparison.reference).chain(comparison.others.iter().map(|other| &other.subject));
    subjects.enumerate().map(|(k, subject)| (subject.name.as_str(), &subject.figures, colour(k))).collect()
}

/// Histograms of errors and of track lengths, in shares of each reconstruction's own.
pub(in crate::report) fn histograms(sides: &[(&str, &ModelFigures, &str)]) -> Vec<Drawing> {
    let lines = |bins: &dyn Fn(&ModelFigures) -> Vec<usize>, start: f64, step: f64| {
        let line = |(name, figures, colour): &(&str, &ModelFigures, &str)| Line {
            label: (*name).to_owned(),
            colour: (*colour).to_owned(),
            points: shares(&bins(figures), start, step),
            ..Line::default()
        };
        sides.iter().map(line).collect::<Vec<_>>()
    };
    let errors = Chart {
        title: "Reprojection errors".into(),
        caption:
            "Share of the observations in each tenth of a pixel; the last bin holds all larger errors. Recomputed \
             from cameras, points and observations."
                .into(),
        unit: "%".into(),
        lines: lines(&|figures| figures.errors.clone(), 0.5 * ERROR_BIN_PX, ERROR_BIN_PX),
        from_zero: true,
        ..Chart::default()
    };
    let tracks = Chart {
        title: "Track lengths".into(),
        caption: "Share of the points by number of observing images; the last bin holds all longer tracks.".into(),
        unit: "%".into(),
        lines: lines(&|figures| figures.track_lengths.clone(), 2.0, 1.0),
        from_zero: true,
        ..Chart::default()
    };
    let last = sides.iter().map(|(_, f, _)| f.track_lengths.len()).max().unwrap_or(1) as f64 + 1.0;
    let widest = ERROR_BIN_PX * NUM_ERROR_BINS as f64;
    [errors.draw_whole((0.0, widest), ticks((0.0, widest)).0), tracks.draw_whole((2.0, last), whole_ticks((2.0, last)))]
        .into_iter()
        .flatten()
        .collect()
}

/// (position, per cent) of bins; empty where all bins are.
fn shares(bins: &[usize], start: f64, step: f64) -> Vec<(f64, f64)> {
    let total: usize = bins.iter().sum();
    if total == 0 {
        return Vec::new();
    }
    let share = |(k, count): (usize, &usize)| (start + step * k as f64, 100.0 * *count as f64 / total as f64);
    bins.iter().enumerate().map(share).collect()
}
