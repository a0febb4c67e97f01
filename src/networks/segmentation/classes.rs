//! Names of a network's classes.

use super::suppression::Candidate;
use crate::ffi::onnx::Model;
use crate::networks::PerceptionError;
use crate::networks::description::{read_sidecar, sidecar_path};
use crate::scene::{Detection, Mask};

/// The [`NUM_COCO`] classes of COCO in the order in which YOLO networks number them.
const COCO: &str = "\
    person, bicycle, car, motorcycle, airplane, bus, train, truck, boat, traffic light, fire hydrant, stop sign, \
    parking meter, bench, bird, cat, dog, horse, sheep, cow, elephant, bear, zebra, giraffe, backpack, umbrella, \
    handbag, tie, suitcase, frisbee, skis, snowboard, sports ball, kite, baseball bat, baseball glove, skateboard, \
    surfboard, tennis racket, bottle, wine glass, cup, fork, knife, spoon, bowl, banana, apple, sandwich, orange, \
    broccoli, carrot, hot dog, pizza, donut, cake, chair, couch, potted plant, bed, dining table, toilet, tv, \
    laptop, mouse, remote, keyboard, cell phone, microwave, oven, toaster, sink, refrigerator, book, clock, vase, \
    scissors, teddy bear, hair drier, toothbrush";

/// Number of COCO's classes.
const NUM_COCO: usize = 80;

/// Class numbers missing in COCO's own annotations; torchvision uses that numbering.
const NOT_IN_COCO: [usize; 10] = [12, 26, 29, 30, 45, 66, 68, 69, 71, 83];

/// Class names by number, with flags of the reported ones.
pub(super) struct Classes {
    pub(super) names: Vec<String>,
    pub(super) wanted: Vec<bool>,
}

impl Classes {
    /// # Errors
    /// [`PerceptionError::NoWantedClass`] if none of the names is wanted.
    pub(super) fn new(model: &Model, names: Vec<String>, wanted: &[String]) -> Result<Self, PerceptionError> {
        let is_wanted: Vec<bool> = names.iter().map(|name| wanted.contains(name)).collect();
        if is_wanted.contains(&true) {
            return Ok(Self { names, wanted: is_wanted });
        }
        let path = model.path().to_path_buf();
        Err(PerceptionError::NoWantedClass { path, wanted: wanted.to_vec(), found: names })
    }

    /// Converts candidates to detections with class names.
    pub(super) fn detections<M>(&self, found: Vec<(Candidate<M>, Mask)>) -> Vec<Detection> {
        let detection = |(candidate, mask): (Candidate<M>, Mask)| {
            let class = self.names[candidate.class_idx].clone();
            Detection { class, confidence: f64::from(candidate.confidence), mask }
        };
        found.into_iter().map(detection).collect()
    }
}

/// Class names of a network with an unknown number of classes, number 0 being the background: from the file next to it,
/// else from its metadata, else COCO's in torchvision's numbering.
pub(super) fn class_names_after_background(model: &Model) -> Result<Vec<String>, PerceptionError> {
    Ok(stated_names(model, |names| !names.is_empty())?.unwrap_or_else(coco_after_background))
}

fn coco_after_background() -> Vec<String> {
    let mut names = vec!["background".to_owned()];
    for name in COCO.split(", ") {
        while NOT_IN_COCO.contains(&names.len()) {
            names.push("N/A".to_owned());
        }
        names.push(name.to_owned());
    }
    names
}

/// Names of a network's `num_classes` classes: from the file next to it, else from its metadata, else those of COCO if
/// their number is 80.
///
/// # Errors
/// [`PerceptionError::NoClassNames`] if none of these gives as many names as there are classes.
pub(super) fn class_names(model: &Model, num_classes: usize) -> Result<Vec<String>, PerceptionError> {
    let stated = stated_names(model, |names| names.len() == num_classes)?;
    let coco = || (num_classes == NUM_COCO).then(|| COCO.split(", ").map(str::to_owned).collect());
    stated.or_else(coco).ok_or_else(|| PerceptionError::NoClassNames {
        path: model.path().to_path_buf(),
        num_classes,
        sidecar: sidecar_path(model.path()),
    })
}

/// Names from the file next to a network, else from its metadata; each only if they fit.
fn stated_names(model: &Model, fit: impl Fn(&Vec<String>) -> bool) -> Result<Option<Vec<String>>, PerceptionError> {
    let beside = read_sidecar(model.path())?.map(|description| description.classes).filter(&fit);
    Ok(beside.or_else(|| parse_names(&model.metadata("names")?).filter(&fit)))
}

/// Parses names in the format of exporters: `{0: 'person', 1: "driver's seat"}` or `['person', 'car']`.
///
/// Returns the quoted strings by number; `None` unless the numbers are 0, 1, 2, ...
fn parse_names(text: &str) -> Option<Vec<String>> {
    let numbered = text.trim_start().starts_with('{');
    let mut names = Vec::new();
    let mut rest = text;
    while let Some(start) = rest.find(['\'', '"']) {
        if numbered {
            let before = rest[..start].trim_end().strip_suffix(':')?.trim_end();
            let digits = before.trim_start_matches(|c: char| !c.is_ascii_digit());
            (digits.parse() == Ok(names.len())).then_some(())?;
        }
        let quote = rest[start..].chars().next()?;
        let (name, after) = quoted(&rest[start + 1..], quote)?;
        names.push(name);
        rest = after;
    }
    Some(names)
}

/// Splits at the closing quote: the text before it, without its escapes, and the rest.
fn quoted(text: &str, quote: char) -> Option<(String, &str)> {
    let mut name = String::new();
    let mut chars = text.char_indices();
    while let Some((i, c)) = chars.next() {
        match c {
            '\\' => name.push(chars.next()?.1),
            c if c == quote => return Some((name, &text[i + 1..])),
            c => name.push(c),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn names_of_any_text_are_read_or_are_none(
            text in "[{]?([0-9]{1,2}|[:'\"\\\\a\u{e9} ,]|[0-9]: 'car', ){0,20}[}]?",
        ) {
            let num_quotes = text.matches(['\'', '"']).count();
            prop_assert!(parse_names(&text).is_none_or(|names| 2 * names.len() <= num_quotes));
        }
    }

    #[test]
    fn names_are_read_in_every_form() {
        assert_eq!(
            parse_names("{0: 'car', 1: \"driver's seat\", 2: 'a\\'b'}").unwrap(),
            ["car", "driver's seat", "a'b"]
        );
        assert_eq!(parse_names("['car', \"bus\"]").unwrap(), ["car", "bus"]);
        assert!(parse_names("{}").unwrap().is_empty());
    }

    #[test]
    fn numbers_with_gaps_or_open_quotes_give_nothing() {
        assert_eq!(parse_names("{0: 'car', 2: 'bus'}"), None);
        assert_eq!(parse_names("{0: 'car"), None);
        assert_eq!(parse_names("{'car'}"), None);
    }

    #[test]
    fn coco_has_its_vehicles_where_they_belong() {
        let names: Vec<&str> = COCO.split(", ").collect();
        assert_eq!(names.len(), NUM_COCO);
        assert_eq!([2, 3, 5, 7].map(|k: usize| names[k]), ["car", "motorcycle", "bus", "truck"]);
        let counted = coco_after_background();
        assert_eq!(counted.len(), 91);
        assert_eq!(
            [0, 1, 3, 8, 21, 90].map(|k: usize| counted[k].as_str()),
            ["background", "person", "car", "truck", "cow", "toothbrush"]
        );
    }
}
