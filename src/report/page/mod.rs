//! Rendering of [`Data`] by the page's template.

mod cards;
mod charts;
mod cost;
mod figures;
mod gaps;
mod models;
mod strip;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use minijinja::{AutoEscape, Environment, Value, context};
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::report::ReportError;
use crate::report::data::{Data, Part};
use crate::report::evaluation::evaluation_facts;
use crate::report::metres::{self, Ruler};
use crate::report::plan::Plan;
use crate::report::scene::Scene;
use crate::report::summary;
use crate::report::timeline::Timeline;
use crate::report::verdict::Verdict;
use crate::report::view::View;
use crate::report::words;
use crate::scene::{ObjectId, TimeBase};

pub(super) const STYLE: &str = include_str!("style.css");
/// Scripts of every page with a 3D view: error handling first, then drawing.
pub(super) const VIEW_SCRIPTS: [&str; 3] =
    [include_str!("errors.js"), include_str!("../../../third_party/three/three.min.js"), include_str!("view3d.js")];
const SCRIPTS: [&str; 4] = [VIEW_SCRIPTS[0], VIEW_SCRIPTS[1], VIEW_SCRIPTS[2], include_str!("page.js")];

/// The page as text.
///
/// # Errors
/// [`ReportError::Template`].
pub fn render(data: &Data) -> Result<String, ReportError> {
    fill(include_str!("report.html"), page_context(data))
}

/// Fills a template, which may include `head` and `brand` and import from `drawing`; everything is escaped.
pub(super) fn fill(template: &str, context: Value) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.set_trim_blocks(true);
    environment.set_lstrip_blocks(true);
    environment.add_template("head", include_str!("head.html"))?;
    environment.add_template("brand", include_str!("brand.html"))?;
    environment.add_template("drawing", include_str!("drawing.html"))?;
    environment.add_template("page", template)?;
    let text = environment.get_template("page")?.render(context)?;
    // HTML forbids control characters; file names may have them.
    Ok(text.replace(|letter: char| letter.is_control() && !matches!(letter, '\n' | '\t' | '\r'), "\u{fffd}"))
}

fn page_context(data: &Data) -> Value {
    let names: Vec<String> = data.objects.iter().map(words::name).collect();
    let timeline = Timeline::new(data);
    let view = View::new(data);
    let scene = view.as_ref().map(|v| Scene::new(data, v, &timeline, &names));
    let mut notes = scene.as_ref().map(|s| s.omissions(data.frames.len())).unwrap_or_default();
    let strip = strip::strip(data, &timeline, &mut notes);
    let film = strip::film(data, &timeline, &mut notes);
    let charts = charts::charts(data, &timeline, &names, &mut notes);
    let missing = gaps::missing(data, &names);
    context! {
        title => &data.title,
        sentence => summary::sentence(data),
        version => &data.version,
        arguments => data.arguments.join(" "),
        input => &data.input,
        figures => figures::key_figures(data, &timeline),
        warnings => gaps::warnings(data, &names, &missing),
        missing,
        is_sfm => data.is_sfm,
        photographs => data.time_base == TimeBase::Frames,
        models => models::models(data, &names),
        cards => if data.is_sfm { Vec::new() } else { cards::cards(data, &timeline, &names, view.as_ref()) },
        plan => view.as_ref().map(|v| Plan::scene(data, v, 0.9)),
        above => view.as_ref().map(|v| Plan::scene(data, v, 0.12)),
        scene => scene.as_ref().map(json),
        up_source => view.as_ref().map(|v| v.up_source),
        unit => Ruler::of(data.metric).unit,
        metres => metres::on_page(data.metric),
        strip,
        film => film.as_ref().map(json),
        bars => charts::bars(data, &timeline, &names),
        ticks => timeline.ticks(),
        clock => clock(&timeline),
        has_seconds => timeline.base == TimeBase::Seconds,
        readings => json(&charts),
        charts,
        stages => cost::stages(data),
        evaluation => data.evaluation.map(|e| evaluation_facts(e, |id| name_of(data, id))),
        verdicts => Verdict::glossary(),
        parts => parts(data),
        notes,
        style => Value::from_safe_string(STYLE.to_owned()),
        scripts => SCRIPTS.map(|s| Value::from_safe_string(s.to_owned())).to_vec(),
        policy => policy(&SCRIPTS),
    }
}

/// Links to the parts of the result.
fn parts(data: &Data) -> Vec<Value> {
    let link = |part: &Part| {
        let holds = match part.object {
            Some(id) => format!("{}: {}", name_of(data, id), part.holds),
            None => part.holds.clone(),
        };
        context! { path => part.path, holds }
    };
    data.parts.iter().map(link).collect()
}

/// The name of an object, which may have nothing but a folder.
fn name_of(data: &Data, id: ObjectId) -> String {
    data.objects.iter().find(|o| o.id == id).map_or_else(|| format!("Object {id}"), words::name)
}

/// Times for `page.js`: in seconds, otherwise frame numbers.
fn clock(timeline: &Timeline) -> Value {
    let (start, end) = timeline.span();
    json(&serde_json::json!({ "start": start, "end": end, "seconds": timeline.base == TimeBase::Seconds }))
}

/// Content security policy: the page's own scripts and embedded images, and nothing else.
pub(super) fn policy(scripts: &[&str]) -> String {
    let hash = |script: &&str| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(script.as_bytes())));
    let hashes: Vec<_> = scripts.iter().map(hash).collect();
    format!(
        "default-src 'none'; script-src {}; style-src 'unsafe-inline'; img-src data: blob:; media-src blob:",
        hashes.join(" ")
    )
}

/// JSON for a script element: without `<`, which could end it.
pub(super) fn json(value: &impl Serialize) -> Value {
    let text = serde_json::to_string(value).expect("numbers, strings and lists always serialise");
    Value::from_safe_string(text.replace('<', "\\u003c"))
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
    fn empty_run_has_a_page() {
        let empty = crate::scene::Reconstruction::default();
        let data = testing::nothing(&empty);
        let page = render(&data).unwrap();
        assert!(page.contains("Nothing reconstructed"));
    }

    #[test]
    fn the_vendored_script_is_the_one_its_readme_names() {
        let hash: String = Sha256::digest(SCRIPTS[1]).iter().map(|b| format!("{b:02x}")).collect();
        assert!(include_str!("../../../third_party/three/README.md").contains(&hash));
    }
}
