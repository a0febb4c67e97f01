//! Which image of one reconstruction is which of the other.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::scene::{Image, ImageId, Reconstruction};

/// Criterion by which images of two models are matched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MatchBy {
    /// The whole name, folders included.
    #[default]
    Name,
    /// The file name without folders and without its ending.
    Stem,
    /// The place in the order of names: the first is the first.
    Order,
}

/// Images that are in both reconstructions, and those that are not.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pairing {
    /// Ids in the reference and in the other, ascending by the reference's name.
    pub common: Vec<(ImageId, ImageId)>,
    /// Names, ascending.
    pub only_in_reference: Vec<String>,
    /// Names, ascending.
    pub only_in_other: Vec<String>,
}

impl Pairing {
    /// Pairs the registered images of two reconstructions. Images that share their key with another one of the same
    /// reconstruction are paired with nothing, since nobody knows which is meant.
    pub fn new(reference: &Reconstruction, other: &Reconstruction, by: MatchBy) -> Self {
        let (ours, theirs) = (keyed(reference, by), keyed(other, by));
        let common: BTreeMap<&str, (ImageId, ImageId)> = ours
            .iter()
            .filter_map(|(key, ids)| Some((key, only(ids)?, only(theirs.get(key)?)?)))
            .map(|(key, id, other_id)| (key_of(reference, id, key, by), (id, other_id)))
            .collect();
        let common: Vec<_> = common.into_values().collect();
        Self {
            only_in_reference: left(reference, common.iter().map(|pair| pair.0)),
            only_in_other: left(other, common.iter().map(|pair| pair.1)),
            common,
        }
    }
}

/// Sort key of pairs: the image's name; for matching by order, the key itself, which is sorted already.
fn key_of<'a>(model: &'a Reconstruction, id: ImageId, key: &'a str, by: MatchBy) -> &'a str {
    if by == MatchBy::Order { key } else { &model.images[&id].name }
}

fn only(ids: &[ImageId]) -> Option<ImageId> {
    if let [id] = *ids { Some(id) } else { None }
}

/// Image ids by what they are paired by.
fn keyed(model: &Reconstruction, by: MatchBy) -> BTreeMap<String, Vec<ImageId>> {
    let mut images: Vec<(&ImageId, &Image)> = model.images.iter().collect();
    images.sort_by(|a, b| a.1.name.cmp(&b.1.name));
    let mut keyed = BTreeMap::<String, Vec<ImageId>>::new();
    for (place, (id, image)) in images.into_iter().enumerate() {
        let key = match by {
            MatchBy::Name => image.name.clone(),
            MatchBy::Stem => stem(&image.name).to_owned(),
            MatchBy::Order => format!("{place:09}"),
        };
        keyed.entry(key).or_default().push(*id);
    }
    keyed
}

/// The file name without folders, of any system, and without its ending.
fn stem(name: &str) -> &str {
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    match file.rfind('.') {
        Some(dot) if dot > 0 => &file[..dot],
        _ => file,
    }
}

/// The names of a reconstruction's images that are not among `paired`, ascending.
fn left(model: &Reconstruction, paired: impl Iterator<Item = ImageId>) -> Vec<String> {
    let paired: std::collections::BTreeSet<ImageId> = paired.collect();
    let rest = model.images.iter().filter(|(id, _)| !paired.contains(id));
    let mut names: Vec<String> = rest.map(|(_, image)| image.name.clone()).collect();
    names.sort();
    names
}
