//! PLY header: elements and the storage of their properties.

use std::path::Path;

use crate::io::IoError;

/// Encoding of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A number's type in binary files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// One number, or a counted list of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Single(Scalar),
    List { count: Scalar, item: Scalar },
}

/// One property of every record of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    pub name: String,
    pub kind: Kind,
}

/// `count` records with the same properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub fn num_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

impl Header {
    /// Reads the header; the second value is the rest of the file.
    pub fn parse<'a>(path: &Path, content: &'a [u8]) -> Result<(Self, &'a [u8]), IoError> {
        let mut rest = content;
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        for number in 1.. {
            let error = |field: &str, problem: &str| IoError::line(path, number, field, problem);
            let Some(end) = rest.iter().position(|&b| b == b'\n') else {
                return Err(error("header", "the file ends here"));
            };
            let line = std::str::from_utf8(&rest[..end]).map_err(|_| error("header", "not text"))?;
            rest = &rest[end + 1..];
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                ["ply"] if number == 1 => {}
                _ if number == 1 => return Err(error("first line", "not 'ply'")),
                [] | ["comment" | "obj_info", ..] => {}
                ["format", name, "1.0"] => {
                    encoding = Some(parse_encoding(name).ok_or_else(|| error("format", "unknown"))?);
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| error("element", "count is not a number"))?;
                    elements.push(Element { name: name.into(), count, properties: Vec::new() });
                }
                ["property", ref description @ ..] => {
                    let property = parse_property(description).ok_or_else(|| error("property", "unknown"))?;
                    let element = elements.last_mut().ok_or_else(|| error("property", "before any element"))?;
                    element.properties.push(property);
                }
                ["end_header"] => break,
                _ => return Err(error("header", "not a line of a PLY header")),
            }
        }
        let encoding = encoding.ok_or_else(|| IoError::content(path, "format line missing in the header"))?;
        check_counts(path, encoding, &elements, rest.len())?;
        Ok((Self { encoding, elements }, rest))
    }
}

fn parse_encoding(name: &str) -> Option<Encoding> {
    match name {
        "ascii" => Some(Encoding::Ascii),
        "binary_little_endian" => Some(Encoding::LittleEndian),
        "binary_big_endian" => Some(Encoding::BigEndian),
        _ => None,
    }
}

fn parse_property(description: &[&str]) -> Option<Property> {
    let (kind, name) = match *description {
        ["list", count, item, name] => {
            let count = Scalar::parse(count).filter(|c| !matches!(c, Scalar::F32 | Scalar::F64))?;
            (Kind::List { count, item: Scalar::parse(item)? }, name)
        }
        [kind, name] => (Kind::Single(Scalar::parse(kind)?), name),
        _ => return None,
    };
    Some(Property { name: name.into(), kind })
}

/// Refuses more records than the rest of the file can hold, before the first of them is read.
fn check_counts(path: &Path, encoding: Encoding, elements: &[Element], num_bytes: usize) -> Result<(), IoError> {
    for element in elements {
        let least: usize = element.properties.iter().map(|p| least_bytes(encoding, p.kind)).sum();
        if element.count > 0 && (least == 0 || element.count > num_bytes.div_ceil(least)) {
            let Element { name, count, .. } = element;
            return Err(IoError::content(path, format!("{count} of '{name}' do not fit in the file; it is truncated")));
        }
    }
    Ok(())
}

fn least_bytes(encoding: Encoding, kind: Kind) -> usize {
    match (encoding, kind) {
        // A digit and a blank.
        (Encoding::Ascii, _) => 2,
        (_, Kind::Single(scalar) | Kind::List { count: scalar, .. }) => scalar.num_bytes(),
    }
}
