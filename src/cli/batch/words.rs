//! Words of a line, as a shell would see them, without what shells replace; and those of the command line itself.

use std::ffi::OsString;

/// Flags for all jobs that a single job does not get: selection, share of the machine, progress.
const OF_ALL: [&str; 7] = ["--index", "--jobs", "--threads", "--memory-limit", "--progress", "--entry", "--parent"];
const OF_ALL_WITHOUT_VALUE: [&str; 4] = ["--quiet", "--json", "--verbose", "-v"];

/// The words of a text: they are parted by blanks, `'` and `"` keep blanks in a word. A backslash is a letter.
///
/// # Errors
/// A quotation that does not end.
pub(super) fn split(text: &str) -> Result<Vec<String>, String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for letter in text.chars() {
        match quote {
            Some(mark) if letter == mark => quote = None,
            None if matches!(letter, '\'' | '"') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            None if letter.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(letter),
        }
    }
    match quote {
        Some(mark) => Err(format!("quotation mark {mark} is not closed")),
        None => {
            words.extend(word);
            Ok(words)
        }
    }
}

/// Takes `flag VALUE` or `flag=VALUE` out of some words; the last one counts.
///
/// # Errors
/// The flag stands last, without a value.
pub(super) fn take_value(words: &mut Vec<String>, flag: &str) -> Result<Option<String>, String> {
    let mut value = None;
    while let Some(at) = words.iter().position(|word| is_flag(word, flag)) {
        value = Some(match words[at].split_once('=') {
            Some((_, value)) => value.to_owned(),
            None if at + 1 < words.len() => words.remove(at + 1),
            None => return Err(format!("{flag}: value missing")),
        });
        words.remove(at);
    }
    Ok(value)
}

fn is_flag(word: &str, flag: &str) -> bool {
    word.strip_prefix(flag).is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
}

/// The command line that does one job of a list alone, from that of all or of another one; `more` is put to it.
pub(super) fn alone(arguments: &[OsString], index: usize, more: &[OsString]) -> Vec<OsString> {
    let end = arguments.iter().position(|word| word == "--").unwrap_or(arguments.len());
    let (flags, rest) = arguments.split_at(end);
    let (mut words, mut is_value) = (Vec::new(), false);
    for word in flags {
        let text = word.to_string_lossy();
        let drops = OF_ALL_WITHOUT_VALUE.contains(&&*text) || OF_ALL.iter().any(|flag| is_flag(&text, flag));
        if !drops && !is_value {
            words.push(word.clone());
        }
        is_value = !is_value && OF_ALL.contains(&&*text);
    }
    words.extend(["--index".into(), index.to_string().into()]);
    words.extend_from_slice(more);
    words.extend_from_slice(rest);
    words
}

/// The index in the list of a job whose run had this command line; `None` for other commands than `batch`.
pub(super) fn index_of_run(arguments: &[String]) -> Option<usize> {
    let at = arguments.iter().position(|word| word == "batch")?;
    let mut words: Vec<String> = arguments[at..].iter().take_while(|word| *word != "--").cloned().collect();
    take_value(&mut words, "--index").ok().flatten()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_part_words_and_quotations_keep_them() {
        assert_eq!(
            split(" --masks  'my masks'\t--set \"a=b c\" x''y ''").unwrap(),
            ["--masks", "my masks", "--set", "a=b c", "xy", ""]
        );
        assert_eq!(split(" \t").unwrap(), Vec::<String>::new());
        assert_eq!(split(r"C:\a").unwrap(), [r"C:\a"]);
        assert!(split("--name 'a").unwrap_err().contains("is not closed"));
    }

    #[test]
    fn a_job_alone_is_told_which_one_it_is_and_nothing_of_the_others() {
        let of = |text: &str| -> Vec<OsString> { text.split(' ').map(OsString::from).collect() };
        let all = of("tractrix --quiet batch --jobs 4 --threads=8 --output o -v --seed 3 -- list");
        assert_eq!(
            alone(&all, 2, &["--threads".into(), "2".into()]),
            of("tractrix batch --output o --seed 3 --index 2 --threads 2 -- list")
        );
        let one = of("tractrix batch list --index 5 --output o");
        assert_eq!(alone(&one, 5, &[]), of("tractrix batch list --output o --index 5"));
    }

    #[test]
    fn the_index_of_a_run_is_read_from_its_command_line() {
        let of = |text: &str| index_of_run(&split(text).unwrap());
        assert_eq!(of("tractrix batch --output o --index 2 --threads 2 -- list"), Some(2));
        assert_eq!((of("tractrix run --output o --index 2"), of("tractrix batch l -- --index 1")), (None, None));
    }

    #[test]
    fn a_value_is_taken_out_in_either_form() {
        let mut words = split("--name a --seed 3 --name=b --names c").unwrap();
        assert_eq!(take_value(&mut words, "--name"), Ok(Some("b".to_owned())));
        assert_eq!(words, ["--seed", "3", "--names", "c"]);
        assert_eq!(take_value(&mut words, "--name"), Ok(None));
        assert!(take_value(&mut vec!["--name".to_owned()], "--name").is_err());
    }
}
