//! Elements of XML files. A truncated file is read up to its last complete element.

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use super::fix::Log;

/// A tag.
pub(super) enum Element<'a> {
    /// Start of an element.
    Start(BytesStart<'a>),
    /// Empty element.
    Empty(BytesStart<'a>),
    /// End of an element: its name, and the text since the last start tag.
    End(&'a str, &'a str),
}

/// Passes the elements of a text to `take`, with the lines where their tags end.
pub(super) fn read(text: &str, log: &mut Log, mut take: impl FnMut(Element<'_>, usize, &mut Log)) {
    let mut reader = Reader::from_str(text);
    reader.config_mut().check_end_names = false;
    let mut lines = LineCounter { text: text.as_bytes(), at: 0, line: 1 };
    let mut content = String::new();
    loop {
        match reader.read_event() {
            Err(error) => {
                let line = lines.at(reader.error_position());
                return log.skip_line(line, format!("file truncated or damaged here ({error})"));
            }
            Ok(Event::Eof) => return,
            Ok(Event::Start(tag)) => {
                content.clear();
                take(Element::Start(tag), lines.at(reader.buffer_position()), log);
            }
            Ok(Event::Empty(tag)) => take(Element::Empty(tag), lines.at(reader.buffer_position()), log),
            Ok(Event::Text(text)) => content.push_str(&text),
            Ok(Event::End(tag)) => {
                let line = lines.at(reader.buffer_position());
                take(Element::End(tag.local_name().as_ref(), &content), line, log);
            }
            Ok(_) => {}
        }
    }
}

/// Line numbers of ascending positions.
struct LineCounter<'a> {
    text: &'a [u8],
    at: usize,
    line: usize,
}

impl LineCounter<'_> {
    fn at(&mut self, position: u64) -> usize {
        let end = usize::try_from(position).unwrap_or(usize::MAX).min(self.text.len());
        if end > self.at {
            self.line += self.text[self.at..end].iter().filter(|&&byte| byte == b'\n').count();
            self.at = end;
        }
        self.line
    }
}
