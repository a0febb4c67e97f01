//! Schema of the tree of options, with their meaning: from the types and their documentation.

use std::sync::LazyLock;

use schemars::generate::SchemaSettings;
use serde_json::{Map, Value};

use super::Options;

/// The JSON schema of [`Options`], without references.
static SCHEMA: LazyLock<Value> = LazyLock::new(|| {
    let mut settings = SchemaSettings::default();
    settings.inline_subschemas = true;
    settings.into_generator().into_root_schema_for::<Options>().to_value()
});

pub(super) fn root() -> &'static Value {
    &SCHEMA
}

/// Node of the tree.
pub(super) enum Node<'a> {
    /// Options with names.
    Group(&'a Map<String, Value>),
    /// Values by the ids of objects.
    ById,
    /// A value, which is given as a whole.
    Leaf,
}

impl<'a> Node<'a> {
    pub(super) fn of(schema: &'a Value) -> Self {
        if let Some(options) = options_of(schema) {
            return Self::Group(options);
        }
        if schema.get("patternProperties").is_some() { Self::ById } else { Self::Leaf }
    }
}

fn options_of(schema: &Value) -> Option<&Map<String, Value>> {
    schema.get("properties")?.as_object()
}

/// The path of an option in a group.
pub(super) fn join(group: &str, name: &str) -> String {
    if group.is_empty() { name.to_owned() } else { format!("{group}.{name}") }
}

/// The options at and below a place of the tree: their paths and schemas.
pub(super) fn leaves<'a>(schema: &'a Value, path: &str) -> Vec<(String, &'a Value)> {
    match Node::of(schema) {
        Node::Group(options) => options.iter().flat_map(|(name, schema)| leaves(schema, &join(path, name))).collect(),
        Node::ById | Node::Leaf => vec![(path.to_owned(), schema)],
    }
}

/// A path as `serde_json` wants it.
pub(super) fn pointer(path: &str) -> String {
    path.split('.').filter(|name| !name.is_empty()).map(|name| format!("/{name}")).collect()
}

/// Effect of an option, and the meaning of each of its choices.
pub(super) fn effect(schema: &Value) -> String {
    let choices: Vec<String> = choices(schema).iter().map(choice).collect();
    [described(schema)].into_iter().chain(choices).filter(|text| !text.is_empty()).collect::<Vec<_>>().join(" ")
}

/// The documentation of a type or field, on one line.
pub(super) fn described(schema: &Value) -> String {
    let text = schema.get("description").and_then(Value::as_str).unwrap_or_default();
    let text = text.replace("[`", "`").replace("`]", "`").replace("`None`", "`null`");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The variants of an enum, which may be missing (`null`).
fn choices(schema: &Value) -> &[Value] {
    let list = |of: &'static str| schema.get(of).and_then(Value::as_array);
    let optional = || list("anyOf").and_then(|either| either.first()).map(choices);
    list("oneOf").map(Vec::as_slice).or_else(optional).unwrap_or_default()
}

fn choice(variant: &Value) -> String {
    let written = match (variant.get("const"), options_of(variant)) {
        (Some(word), _) => word.to_string(),
        (None, Some(content)) => content.keys().map(|name| format!("{{\"{name}\": …}}")).collect(),
        (None, None) => variant.get("enum").map(Value::to_string).unwrap_or_default(),
    };
    format!("`{written}`: {}", described(variant))
}

/// The unit of a number: as the documentation says, else as the name ends.
pub(super) fn unit(name: &str, schema: &Value) -> Option<String> {
    const ENDINGS: [(&str, &str); 4] =
        [("_px", "pixels"), ("_px2", "square pixels"), ("_deg", "degrees"), ("_secs", "seconds")];
    let stated = schema.get("unit").and_then(Value::as_str);
    let from_name = || ENDINGS.iter().find(|(ending, _)| name.ends_with(ending)).map(|(_, unit)| *unit);
    stated.or_else(from_name).map(str::to_owned)
}

/// A value as it is written in JSON. Those of single precision are not given more digits than they have.
pub(super) fn written(schema: &Value, value: &Value) -> String {
    let single = schema.get("format").is_some_and(|format| format == "float");
    match value.as_f64().filter(|_| single) {
        Some(value) => format!("{:?}", value as f32),
        None => value.to_string(),
    }
}
