//! Text for people.

use std::borrow::Cow;

/// A text whose control characters are spelled `\u001b`, as JSON does: names of files and words of other programs could
/// steer the terminal by them. Line breaks and tabs stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_unprintable) {
        return Cow::Borrowed(text);
    }
    let mut spelled = String::with_capacity(text.len());
    for letter in text.chars() {
        match is_unprintable(letter) {
            true => spelled.push_str(&format!("\\u{:04x}", u32::from(letter))),
            false => spelled.push(letter),
        }
    }
    Cow::Owned(spelled)
}

fn is_unprintable(letter: char) -> bool {
    // Marks that turn the direction of writing change what is read as well.
    let turns = matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || (letter.is_control() && !matches!(letter, '\n' | '\t'))
}

/// An error with its causes, as one line. Causes that the text already carries are not repeated.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(next) = cause {
        let more = next.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = next.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_steers_a_terminal() {
        let hostile = "\u{1b}]0;title\u{7}\u{9b}2J a\tb\r\n\u{7f}é\u{202e}";
        assert_eq!(printable(hostile), "\\u001b]0;title\\u0007\\u009b2J a\tb\\u000d\n\\u007fé\\u202e");
        assert!(matches!(printable("Straße\t12 %\n"), Cow::Borrowed(_)));
        let json = serde_json::to_string("\u{9b}\u{7f}\u{1b}").unwrap();
        assert_eq!(serde_json::from_str::<String>(&printable(&json)).unwrap(), "\u{9b}\u{7f}\u{1b}");
    }
}
