//! From [`Data`] to the context of the template, and from there to text.

mod cards;
mod charts;
mod cost;
mod figures;
mod gaps;
mod strip;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use minijinja::{AutoEscape, Environment, Value, context};
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::report::ReportError;
use crate::report::data::Data;
use crate::report::plan::Plan;
use crate::report::scene::Scene;
use crate::report::summary;
use crate::report::view::View;
use crate::scene::Unit;

const TEMPLATE: &str = include_str!("report.html");
const STYLE: &str = include_str!("style.css");
const SCRIPTS: [&str; 4] = [
    include_str!("errors.js"),
    include_str!("../../../third_party/three/three.min.js"),
    include_str!("view3d.js"),
    include_str!("page.js"),
];

/// Fills the template.
pub(super) fn render(data: &Data) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.set_trim_blocks(true);
    environment.set_lstrip_blocks(true);
    environment.add_template("report", TEMPLATE)?;
    Ok(environment.get_template("report")?.render(page_context(data))?)
}

fn page_context(data: &Data) -> Value {
    let names: Vec<String> = data.objects.iter().map(summary::name).collect();
    let view = View::new(data);
    let unit = unit_word(data.unit);
    let scene = view.as_ref().map(|v| Scene::new(data, v, &names));
    let mut notes = scene.as_ref().map(|s| s.omissions(data.frames.len())).unwrap_or_default();
    let strip = strip::strip(data, &mut notes);
    let charts = charts::charts(data, &names, &mut notes);
    let cards: Vec<_> =
        data.objects.iter().zip(&names).map(|(o, n)| cards::card(data, o, n, view.as_ref(), unit)).collect();
    let times = times(data);
    context! {
        title => &data.title,
        sentence => summary::sentence(data),
        version => &data.version,
        arguments => data.arguments.join(" "),
        input => &data.input,
        figures => figures::key_figures(data),
        warnings => &data.warnings,
        missing => gaps::missing(data, &names),
        cards,
        plan => view.as_ref().map(|v| Plan::scene(data, v, unit)),
        scene => scene.as_ref().map(json),
        up_source => view.as_ref().map(|v| v.up_source),
        strip,
        bars => charts::bars(data, &names, &times),
        bar_ticks => charts::bar_ticks(&times),
        span => [times.first(), times.last()],
        readings => json(&charts),
        charts,
        stages => cost::stages(data),
        evaluation => &data.evaluation,
        notes,
        style => Value::from_safe_string(STYLE.to_owned()),
        scripts => SCRIPTS.map(|s| Value::from_safe_string(s.to_owned())).to_vec(),
        policy => policy(),
    }
}

/// What the page may do: run our own scripts, show pictures that it holds itself, and nothing else.
fn policy() -> String {
    let hashes = SCRIPTS.map(|s| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(s.as_bytes()))));
    format!("default-src 'none'; script-src {}; style-src 'unsafe-inline'; img-src data: blob:", hashes.join(" "))
}

/// JSON for a script element: without `<`, which could end it.
fn json(value: &impl Serialize) -> Value {
    let text = serde_json::to_string(value).expect("numbers, strings and lists always serialise");
    Value::from_safe_string(text.replace('<', "\\u003c"))
}

fn unit_word(unit: Unit) -> &'static str {
    match unit {
        Unit::Metre => "m",
        Unit::Background => "units",
    }
}

/// Times of the frames and the end of the last one, each above the one before.
fn times(data: &Data) -> Vec<f64> {
    let mut times: Vec<f64> = Vec::with_capacity(data.frames.len() + 1);
    for frame in data.frames {
        let last = times.last().copied().unwrap_or(f64::NEG_INFINITY);
        let usable = frame.time_s.is_finite() && frame.time_s > last;
        times.push(if usable {
            frame.time_s
        } else if last.is_finite() {
            last + 1e-3
        } else {
            0.0
        });
    }
    let first = times.first().copied().unwrap_or(0.0);
    let last = times.last().copied().unwrap_or(0.0);
    let step = if times.len() > 1 { (last - first) / (times.len() - 1) as f64 } else { 1.0 };
    times.push(last + step);
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn the_page_is_self_contained() {
        let world = testing::world();
        let page = render(&world.data()).unwrap();
        for mark in ["src=\"http", "href=\"http", "src='http", "@import url(http"] {
            assert!(!page.contains(mark), "{mark}");
        }
        assert_eq!(page.matches("<script").count(), page.matches("</script>").count());
        for script in SCRIPTS {
            assert!(!script.contains("</script") && !script.contains("<!--"));
        }
    }

    #[test]
    fn hostile_names_are_escaped() {
        let mut world = testing::world();
        let evil = "</script><img src=x onerror=alert(1)>\"'";
        world.title = evil.into();
        world.class = evil.into();
        world.frames[0].name = evil.into();
        world.warnings = vec![evil.into()];
        let page = render(&world.data()).unwrap();
        assert!(!page.contains("<img src=x"), "escaped wherever it stands");
        assert!(page.contains("&lt;img src=x"));
    }

    #[test]
    fn a_run_that_found_nothing_has_a_page_too() {
        let empty = crate::scene::Reconstruction::default();
        let data = testing::nothing(&empty);
        let page = render(&data).unwrap();
        assert!(page.contains("Nothing could be reconstructed"));
    }

    #[test]
    fn the_vendored_script_is_the_one_its_readme_names() {
        let hash: String = Sha256::digest(SCRIPTS[1]).iter().map(|b| format!("{b:02x}")).collect();
        assert!(include_str!("../../../third_party/three/README.md").contains(&hash));
    }
}
