//! XML documents.

use std::io::Write;
use std::path::Path;

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};

use super::ExportError;
use crate::io::atomic;

/// An XML document under construction.
pub(super) type Xml<'a> = Writer<&'a mut dyn Write>;

/// Writes a file with its root element.
pub(super) fn write(
    path: &Path,
    root: &str,
    attributes: &[(&str, &str)],
    content: impl FnOnce(&mut Xml) -> std::io::Result<()>,
) -> Result<(), ExportError> {
    let document = |out: &mut dyn Write| {
        let mut xml = Writer::new_with_indent(out, b' ', 1);
        xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
        xml.create_element(root).with_attributes(attributes.iter().copied()).write_inner_content(content)?;
        xml.into_inner().write_all(b"\n")
    };
    Ok(atomic::write_with(path, document)?)
}

/// Writes an element with text content.
pub(super) fn element(xml: &mut Xml, name: &str, text: &str) -> std::io::Result<()> {
    xml.create_element(name).write_text_content(BytesText::new(&allowed(text))).map(drop)
}

/// A text without the characters that XML forbids even escaped.
pub(super) fn allowed(text: &str) -> String {
    text.chars().map(|c| if is_allowed(c) { c } else { '?' }).collect()
}

fn is_allowed(c: char) -> bool {
    matches!(c, '\t' | '\n' | '\r' | ' '..='\u{d7ff}' | '\u{e000}'..='\u{fffd}' | '\u{10000}'..)
}
