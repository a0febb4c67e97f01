//! Entries of GPMF: key, type, size and number of samples, then the samples, big-endian and padded to four bytes.

/// Entry of GPMF.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry<'a> {
    /// Four letters.
    pub(super) key: [u8; 4],
    /// Type of the samples' numbers; 0 where entries are nested, `?` where `TYPE` lists them.
    kind: u8,
    /// Bytes of a sample.
    size: usize,
    /// Complete samples only; samples that a damaged file declares but does not contain are missing.
    pub(super) data: &'a [u8],
}

/// Iterates over the entries of a byte range, up to its end, padding, or the first truncated entry. Every step advances
/// by at least the header of an entry.
pub(super) fn entries(bytes: &[u8]) -> impl Iterator<Item = Entry<'_>> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        let (head, after) = rest.split_first_chunk::<8>()?;
        let &[a, b, c, d, kind, size, high, low] = head;
        let (key, size) = ([a, b, c, d], usize::from(size));
        if key == [0; 4] {
            return None;
        }
        let stated = size * usize::from(u16::from_be_bytes([high, low]));
        let held = stated.min(after.len());
        rest = after.get(stated.next_multiple_of(4)..).unwrap_or_default();
        let data = if kind == 0 || size == 0 { &after[..held] } else { &after[..held - held % size] };
        Some(Entry { key, kind, size, data })
    })
}

impl<'a> Entry<'a> {
    /// Entries inside a nested entry.
    pub(super) fn nested(&self) -> impl Iterator<Item = Entry<'a>> + use<'a> {
        entries(if self.kind == 0 { self.data } else { &[] })
    }

    /// Number of samples.
    pub(super) fn len(&self) -> usize {
        self.data.len().checked_div(self.size).unwrap_or(0)
    }

    /// First `N` numbers of a sample, unscaled; `None` if it has fewer, or of unknown type. Samples are read one by
    /// one: a damaged file may have many samples of one byte each.
    ///
    /// * `types` – types of a sample's numbers if the entry refers to `TYPE`.
    pub(super) fn sample<const N: usize>(&self, index: usize, types: &[u8]) -> Option<[f64; N]> {
        let sample = self.data.chunks_exact(self.size.max(1)).nth(index)?;
        let (mut numbers, mut at) = ([0.0; N], 0);
        for (i, value) in numbers.iter_mut().enumerate() {
            let kind = if self.kind == b'?' { *types.get(i)? } else { self.kind };
            *value = number(kind, sample.get(at..at + width(kind)?)?)?;
            at += width(kind)?;
        }
        Some(numbers)
    }

    /// First number of the first sample.
    pub(super) fn number(&self) -> Option<f64> {
        self.sample::<1>(0, &[]).map(|[value]| value).filter(|value| value.is_finite())
    }

    /// All numbers of an entry of one type, at most `most`.
    pub(super) fn numbers(&self, most: usize) -> Vec<f64> {
        let width = width(self.kind).unwrap_or(usize::MAX);
        self.data.chunks_exact(width).take(most).filter_map(|bytes| number(self.kind, bytes)).collect()
    }

    /// Text up to its first zero; control characters and non-ASCII characters are replaced.
    pub(super) fn text(&self) -> String {
        /// Maximum length of a text; names of cameras have a dozen letters.
        const MAX_CHARS: usize = 64;
        let shown = |byte: &u8| if byte.is_ascii_graphic() || *byte == b' ' { char::from(*byte) } else { '?' };
        let text: String = self.data.iter().take_while(|byte| **byte != 0).take(MAX_CHARS).map(shown).collect();
        text.trim().to_owned()
    }
}

/// Number of bytes of a number.
fn width(kind: u8) -> Option<usize> {
    match kind {
        b'b' | b'B' => Some(1),
        b's' | b'S' => Some(2),
        b'l' | b'L' | b'f' | b'q' => Some(4),
        b'd' | b'j' | b'J' | b'Q' => Some(8),
        _ => None,
    }
}

/// Parses the number at the start of a byte slice.
fn number(kind: u8, bytes: &[u8]) -> Option<f64> {
    let two = || bytes.first_chunk::<2>();
    let four = || bytes.first_chunk::<4>();
    let eight = || bytes.first_chunk::<8>();
    Some(match kind {
        b'b' => f64::from(i8::from_be_bytes(*bytes.first_chunk()?)),
        b'B' => f64::from(*bytes.first()?),
        b's' => f64::from(i16::from_be_bytes(*two()?)),
        b'S' => f64::from(u16::from_be_bytes(*two()?)),
        b'l' => f64::from(i32::from_be_bytes(*four()?)),
        b'L' => f64::from(u32::from_be_bytes(*four()?)),
        b'f' => f64::from(f32::from_be_bytes(*four()?)),
        b'd' => f64::from_be_bytes(*eight()?),
        b'j' => i64::from_be_bytes(*eight()?) as f64,
        b'J' => u64::from_be_bytes(*eight()?) as f64,
        // Fixed point: 16 or 32 fractional bits.
        b'q' => f64::from(i32::from_be_bytes(*four()?)) / 65_536.0,
        b'Q' => i64::from_be_bytes(*eight()?) as f64 / 4_294_967_296.0,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::super::made::entry;
    use super::*;

    #[test]
    fn entries_have_samples_of_every_type() {
        let bytes = [
            entry(b"AAAA", b's', 4, &[1i16, -2, 3, 4].map(i16::to_be_bytes).concat()),
            entry(b"BBBB", b'B', 1, &[7, 8, 9]),
            entry(b"CCCC", b'?', 10, &[&1e9f32.to_be_bytes()[..], &[0, 5], &(-7i32).to_be_bytes()].concat()),
            entry(b"DDDD", b'c', 1, b"GoPro\x01\0x"),
        ]
        .concat();
        let found: Vec<Entry> = entries(&bytes).collect();
        assert_eq!(found.iter().map(Entry::len).collect::<Vec<_>>(), [2, 3, 1, 8]);
        assert_eq!((found[0].sample(0, &[]), found[0].sample(1, &[])), (Some([1.0, -2.0]), Some([3.0, 4.0])));
        assert_eq!((found[0].sample::<3>(0, &[]), found[0].sample::<1>(2, &[])), (None, None), "two samples of two");
        assert_eq!((found[1].numbers(2), found[1].number()), (vec![7.0, 8.0], Some(7.0)));
        assert_eq!(found[2].sample(0, b"fSl"), Some([1e9, 5.0, -7.0]));
        assert_eq!((found[2].sample::<3>(0, b"fS"), found[2].sample::<3>(0, b"fSd")), (None, None));
        assert_eq!(found[3].text(), "GoPro?");
    }

    #[test]
    fn an_entry_beyond_the_end_keeps_its_whole_samples() {
        let mut bytes = entry(b"AAAA", b'l', 4, &[1i32, 2, 3].map(i32::to_be_bytes).concat());
        bytes.truncate(bytes.len() - 1);
        let found: Vec<Entry> = entries(&bytes).collect();
        assert_eq!((found.len(), found[0].numbers(9)), (1, vec![1.0, 2.0]));
        assert_eq!(entries(b"AAAA\0\0").count() + entries(&[0; 64]).count(), 0);
        // Sizes of zero advance as well.
        assert_eq!(entries(&b"AAAAl\0\xff\xff".repeat(3)).count(), 3);
    }
}
