//! Page of a comparison: all reconstructions in one 3D view, differences over images, histograms, all figures.
//!
//! It is built like the report ([`super`]): one file without external resources, with the report's style and 3D view.

pub(super) mod charts;
mod scene;

use minijinja::{Value, context};

use super::ReportError;
use super::page::{STYLE, VIEW_SCRIPTS, fill, json, policy};
use super::words::{UNKNOWN, count, percent, thousands};
use crate::eval::comparison::{Against, Comparison, ImageDifference, LengthUnit};
use crate::scene::Reconstruction;

const SCRIPTS: [&str; 4] = [VIEW_SCRIPTS[0], VIEW_SCRIPTS[1], VIEW_SCRIPTS[2], include_str!("compare.js")];

/// Colors of the reconstructions, the reference first; distinguished also by the color-blind (after Okabe and Ito).
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#777777"];

/// Maximum number of images listed per reconstruction in a table.
pub(super) const MAX_ROWS: usize = 200;

/// Content of the page.
#[derive(Clone, Debug)]
pub struct Data<'a> {
    /// The figures.
    pub comparison: &'a Comparison,
    /// The reference's reconstruction, then those of the others in their order.
    pub models: Vec<&'a Reconstruction>,
    /// The command line.
    pub arguments: Vec<String>,
}

/// The page as text.
///
/// # Errors
/// [`ReportError::Template`].
pub fn render(data: &Data) -> Result<String, ReportError> {
    fill(include_str!("compare.html"), page_context(data))
}

pub(super) fn colour(side: usize) -> &'static str {
    COLOURS[side % COLOURS.len()]
}

fn page_context(data: &Data) -> Value {
    let comparison = data.comparison;
    let scene = scene::Scene::new(data);
    let [unit, one] = units(comparison.unit);
    let names: Vec<&str> = std::iter::once(&comparison.reference)
        .chain(comparison.others.iter().map(|other| &other.subject))
        .map(|subject| subject.name.as_str())
        .collect();
    let details: Vec<_> = (1..).zip(&comparison.others).map(|(k, other)| details(k, other)).collect();
    let sides: Vec<_> = names.iter().enumerate().map(|(k, name)| context! { name, colour => colour(k) }).collect();
    context! {
        title => names.join(" · "),
        sentences => comparison.others.iter().map(|other| sentence(other, comparison)).collect::<Vec<_>>(),
        version => crate::VERSION,
        arguments => data.arguments.join(" "),
        sides,
        table => comparison.table(),
        charts => charts::charts(data),
        histograms => charts::histograms(&charts::sides(comparison)),
        details,
        unit,
        one,
        reference => names[0],
        scene => scene.as_ref().map(json),
        omissions => scene.as_ref().map(scene::Scene::omissions),
        style => Value::from_safe_string(STYLE.to_owned()),
        scripts => SCRIPTS.map(|s| Value::from_safe_string(s.to_owned())).to_vec(),
        policy => policy(&SCRIPTS),
    }
}

/// The unit of lengths, and its singular.
fn units(unit: LengthUnit) -> [&'static str; 2] {
    match unit {
        LengthUnit::Metre => ["meters", "meter"],
        LengthUnit::Reference => ["units of the first", "unit of the first"],
    }
}

/// Main result in a sentence.
fn sentence(other: &Against, comparison: &Comparison) -> String {
    let (name, reference) = (&other.subject.name, &comparison.reference.name);
    let (alignment, cameras) = match (other.alignment.as_ref(), other.cameras.as_ref()) {
        (Ok(alignment), Ok(cameras)) => (alignment, cameras),
        (Err(reason), _) | (_, Err(reason)) => return format!("{name} cannot be compared with {reference}: {reason}."),
    };
    let lost = match alignment.lost.len() {
        0 => String::new(),
        1 => " 1 camera is lost: excluded from the alignment.".to_owned(),
        lost => format!(" {lost} cameras are lost: excluded from the alignment."),
    };
    format!(
        "{name}: {} of the {} of {reference} are registered in both; the camera centers differ by {} (RMSE, {} \
         of the path's extent), the rotations by {:.3}° on average.{lost}",
        other.num_common,
        count(comparison.reference.figures.num_images, "image"),
        with_unit(cameras.center_rmse, comparison.unit),
        percent(cameras.center_share_of_extent),
        cameras.rotation_mean_deg
    )
}

fn with_unit(length: f64, of: LengthUnit) -> String {
    let [unit, one] = units(of);
    let text = super::words::with_unit(length, 3, unit);
    if text.starts_with("1 ") { format!("1 {one}") } else { text }
}

/// Details of one reconstruction, below the charts.
fn details(side: usize, other: &Against) -> Value {
    let intrinsics = other.intrinsics.iter().map(|pair| {
        let [reference, here] = pair.in_figures();
        [thousands(pair.num_images), reference, here]
    });
    context! {
        name => other.subject.name,
        colour => colour(side),
        intrinsics => intrinsics.collect::<Vec<_>>(),
        only_in_reference => other.only_in_reference,
        only_in_other => other.only_in_other,
        rows => other.images.iter().take(MAX_ROWS).map(row).collect::<Vec<_>>(),
        left_out => other.images.len().saturating_sub(MAX_ROWS),
    }
}

fn row(image: &ImageDifference) -> [String; 6] {
    let number = |value: Option<f64>, digits| value.map_or(UNKNOWN.to_owned(), |v| super::words::figure(v, digits));
    let [ours, theirs] = image.num_observations;
    [
        image.name.clone(),
        number(image.center, 4),
        number(image.rotation_deg, 4),
        format!("{ours} / {theirs}"),
        format!("{} / {}", number(image.error_px[0], 3), number(image.error_px[1], 3)),
        if image.lost { "lost".into() } else { String::new() },
    ]
}

#[cfg(test)]
mod tests;
