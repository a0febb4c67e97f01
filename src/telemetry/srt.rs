//! SubRip: blocks of a number, a time and lines of text, separated by empty lines. Also the entries of SubStation
//! Alpha, one per line: `Dialogue: 0,0:00:00.00,0:00:01.00,Default,,0,0,0,,text\Ntext`.

use super::text::check_length;
use super::time::subtitle_s;

/// Entry of a subtitle file or of a video's subtitle track.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Subtitle<'a> {
    /// First line of its text in the file, from 1; for a track the number of the entry.
    pub(super) line: usize,
    /// Start, seconds after the video's start; `None` if it has no time.
    pub(super) start_s: Option<f64>,
    /// Text, line by line.
    pub(super) lines: Vec<&'a str>,
}

/// Maximum number of lines kept of one entry: cameras write a dozen.
const MAX_LINES: usize = 64;

/// Passes the blocks of a file to `take`. A block starts after an empty line and, if that is missing, at a second line
/// with times. For too long lines, `take` gets the number and the reason.
pub(super) fn blocks<'a>(text: &'a str, mut take: impl FnMut(Result<Subtitle<'a>, (usize, String)>)) {
    let mut block = Subtitle { line: 1, start_s: None, lines: Vec::new() };
    // In SubStation Alpha only the entries are used.
    let is_alpha = text.trim_start().starts_with("[Script Info]");
    let wanted = |(_, content): &(usize, &str)| !is_alpha || content.trim_start().starts_with("Dialogue:");
    for (line, content) in (1..).zip(text.lines()).filter(wanted) {
        if let Err(reason) = check_length(content) {
            take(Err((line, reason)));
            continue;
        }
        let content = content.trim();
        if let Some(entry) = content.strip_prefix("Dialogue:").and_then(|fields| dialogue(fields, line)) {
            take(Ok(entry));
            continue;
        }
        let start_s = content.split_once("-->").and_then(|(start, _)| subtitle_s(start));
        let is_next = content.is_empty() || (start_s.is_some() && block.start_s.is_some());
        if is_next {
            finish(&mut block).into_iter().for_each(|whole| take(Ok(whole)));
        }
        match start_s {
            Some(_) => block = Subtitle { line: line + 1, start_s, lines: Vec::new() },
            None if content.is_empty() || is_counter(content, &block) => block.line = line + 1,
            None if block.lines.len() < MAX_LINES => block.lines.push(content),
            None => {}
        }
    }
    finish(&mut block).into_iter().for_each(|whole| take(Ok(whole)));
}

/// Parses an entry of SubStation Alpha.
fn dialogue(fields: &str, line: usize) -> Option<Subtitle<'_>> {
    // Layer, start, end, style, name, three margins, effect, text.
    let mut fields = fields.splitn(10, ',');
    let start_s = subtitle_s(fields.nth(1)?);
    let lines = fields.nth(7)?.split("\\N").map(str::trim).take(MAX_LINES).collect();
    Some(Subtitle { line, start_s, lines })
}

/// Returns true if a line is the number before a block's times.
fn is_counter(content: &str, block: &Subtitle) -> bool {
    block.start_s.is_none() && block.lines.is_empty() && content.bytes().all(|byte| byte.is_ascii_digit())
}

/// Returns the current block unless it is empty, and starts the next one.
fn finish<'a>(block: &mut Subtitle<'a>) -> Option<Subtitle<'a>> {
    let line = block.line;
    let whole = std::mem::replace(block, Subtitle { line, start_s: None, lines: Vec::new() });
    (whole.start_s.is_some() || !whole.lines.is_empty()).then_some(whole)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(text: &str) -> Vec<Subtitle<'_>> {
        let mut found = Vec::new();
        blocks(text, |block| found.push(block.unwrap()));
        found
    }

    #[test]
    fn blocks_have_times_lines_and_numbers() {
        let text =
            "1\r\n00:00:00,000 --> 00:00:01,000\r\na\r\nb\r\n\r\n\r\n2\n00:00:01,500 --> 00:00:02,000\nc\n\n3\nd\n";
        let found = all(text);
        let expected = [(3, Some(0.0), vec!["a", "b"]), (9, Some(1.5), vec!["c"]), (12, None, vec!["d"])];
        let found: Vec<_> = found.into_iter().map(|block| (block.line, block.start_s, block.lines)).collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn entries_of_one_line_have_times_and_lines() {
        let found =
            all("[Script Info]\nFormat: Layer, Start\nDialogue: 0,0:00:01.50,0:00:02.00,Default,,0,0,0,,a,b \\N c\n");
        assert_eq!(found, [Subtitle { line: 3, start_s: Some(1.5), lines: vec!["a,b", "c"] }]);
    }

    #[test]
    fn a_lost_empty_line_does_not_join_two_blocks() {
        let text = "00:00:00,000 --> 00:00:01,000\na\n00:00:01,000 --> 00:00:02,000\nb";
        let found = all(text);
        assert_eq!(found.len(), 2);
        assert_eq!((found[1].line, found[1].lines.as_slice()), (4, ["b"].as_slice()));
    }

    #[test]
    fn a_megabyte_on_one_line_is_one_line() {
        let long = "x".repeat(1 << 20);
        let mut refused = Vec::new();
        let text = format!("1\n00:00:00,000 --> 00:00:01,000\n{long}\nb");
        blocks(&text, |block| match block {
            Ok(block) => assert_eq!(block.lines, ["b"]),
            Err(refusal) => refused.push(refusal),
        });
        assert!(refused[0].0 == 3 && refused[0].1.contains("1048576"), "{refused:?}");
    }
}
