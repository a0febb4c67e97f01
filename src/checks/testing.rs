//! Options with numbers that are hard to bear: what a check lets through must do no harm.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// Options with each number in turn replaced by each of a list of others, as far as these can be read, and what was
/// replaced by what.
pub(crate) fn variations<T: Serialize + DeserializeOwned>(options: &T) -> Vec<(String, T)> {
    let hard = [0, 1, 2, 3, 10, 90, 1000, 100_000, 1_000_000].map(|n: i64| json!(n));
    let hard = hard.into_iter().chain([json!(-1), json!(u64::MAX)]);
    let hard: Vec<Value> = hard.chain([1e-9, 1e-3, 0.02, 0.1, 0.9, 1e300, -1e300].map(|x| json!(x))).collect();
    let tree = json!(options);
    let changed = |path: &String, value: &Value| {
        let mut tree = tree.clone();
        *tree.pointer_mut(path)? = value.clone();
        Some((format!("{path} = {value}"), serde_json::from_value(tree).ok()?))
    };
    numbers(&tree, "")
        .iter()
        .flat_map(|path| hard.iter().filter_map(|value| changed(path, value)).collect::<Vec<_>>())
        .collect()
}

/// JSON pointers to all numbers of a tree.
pub(crate) fn numbers(tree: &Value, path: &str) -> Vec<String> {
    match tree {
        Value::Number(_) => vec![path.to_owned()],
        Value::Object(map) => map.iter().flat_map(|(key, value)| numbers(value, &format!("{path}/{key}"))).collect(),
        Value::Array(list) => {
            list.iter().enumerate().flat_map(|(k, value)| numbers(value, &format!("{path}/{k}"))).collect()
        }
        _ => Vec::new(),
    }
}
