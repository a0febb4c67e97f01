//! Every option with its default, its unit and its effect: for `tractrix options` and for docs/options.md.

use serde_json::{Value, json};

use super::Options;
use super::public::{is_public, spelled};
use super::schema::{self, Node, pointer};
use crate::features::Target;
use crate::sfm;

/// An option.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OptionRow {
    /// Its path as users write it, separated by dots.
    pub key: String,
    /// False for an option below `tuning`.
    pub is_public: bool,
    /// Its value in each of the trees that were asked for, as JSON.
    pub values: Vec<String>,
    /// The unit of its value, where that has one.
    pub unit: Option<String>,
    /// Effect.
    pub effect: String,
}

/// Options that belong together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OptionSection {
    /// Heading.
    pub title: String,
    /// Purpose.
    pub about: String,
    /// Whose defaults the rows hold.
    pub columns: Vec<String>,
    /// The options.
    pub rows: Vec<OptionRow>,
}

impl Options {
    /// Every option with its value here and its default.
    pub fn rows(&self) -> Vec<OptionRow> {
        let all = rows(schema::root(), "", &[json!(self), json!(Self::default())]);
        let (public, tuning): (Vec<_>, Vec<_>) = all.into_iter().partition(|row| row.is_public);
        public.into_iter().chain(tuning).collect()
    }

    /// The public options with their defaults.
    pub fn reference() -> Vec<OptionSection> {
        let (trees, schema) = ([json!(Self::default())], schema::root());
        let Node::Group(known) = Node::of(schema) else { return Vec::new() };
        let (groups, values): (Vec<_>, Vec<_>) =
            known.iter().partition(|(_, schema)| matches!(Node::of(schema), Node::Group(_)));
        let values = values.into_iter().flat_map(|(name, schema)| rows(schema, name, &trees)).collect();
        let mut sections = vec![section("The root".to_owned(), schema::described(schema), values)];
        for (name, schema) in groups {
            match name.as_str() {
                "background" => sections.extend(targets(schema)),
                "objects" => {}
                _ => {
                    let mut rows = rows(schema, name, &trees);
                    rows.retain(|row| row.is_public);
                    sections.push(section(format!("`{name}`"), schema::described(schema), rows));
                }
            }
        }
        sections.retain(|section| !section.rows.is_empty());
        sections
    }
}

fn section(title: String, about: String, rows: Vec<OptionRow>) -> OptionSection {
    OptionSection { title, about, columns: vec!["default".to_owned()], rows }
}

/// The options of structure from motion, which background and objects have in common.
fn targets(schema: &Value) -> Vec<OptionSection> {
    let trees = [Target::Background, Target::Object].map(|target| json!({ "background": sfm::Options::of(target) }));
    let mut rows = rows(schema, "background", &trees);
    rows.retain(|row| row.is_public);
    for row in &mut rows {
        row.key = row.key.replacen("background.", "", 1);
    }
    vec![OptionSection {
        title: "`background` and `objects`".to_owned(),
        about: schema::described(schema),
        columns: ["background", "objects"].map(str::to_owned).to_vec(),
        rows,
    }]
}

/// The options at and below a place of the tree.
///
/// * `trees` – whole trees, whose values are given.
fn rows(schema: &Value, path: &str, trees: &[Value]) -> Vec<OptionRow> {
    let row = |(path, schema): (String, &Value)| OptionRow {
        key: spelled(&path),
        is_public: is_public(&path),
        values: trees
            .iter()
            .map(|tree| schema::written(schema, &tree.pointer(&pointer(&path)).cloned().unwrap_or_default()))
            .collect(),
        unit: schema::unit(&path, schema),
        effect: schema::effect(schema),
    };
    schema::leaves(schema, path).into_iter().map(row).collect()
}
