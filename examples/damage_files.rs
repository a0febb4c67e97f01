//! Damages files at random and reads them: no reader may panic, hang or take memory that the file does not need.
//!
//!     damage_files READER SECONDS [FILE...] [--seed N] [--keep DIR]
//!
//! READER is `colmap-text`, `colmap-binary`, `openmvg`, `opensfm`, `nerfstudio`, `nvm`, `bundler`, `tum`, `kitti`,
//! `ply`, `bal`, `trajectories`, `tracks`, `ground`, `mask` or `sequence`. Without FILEs the reader's files are written
//! from the small models in `tests/golden`; `ply`, `bal`, `trajectories`, `tracks`, `ground`, `mask` and `sequence`
//! need one. What was read is written as a COLMAP model and read again. Run it under `ulimit -v` to have memory that is
//! asked for and not used count as well, and with `TMPDIR` in memory: every case is a file.
//!
//! Prints how many files were read, accepted and refused, panics, the slowest file, and the largest resident memory;
//! exit code 1 after a panic. With `--keep` panics are shown, and the files that panicked, and the slowest, stay.

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use rand::Rng as _;
use tractrix::io::model::{self, Format};
use tractrix::io::{Sequence, bal, colmap, ground, masks, ply, tracks, trajectories};
use tractrix::math::{Rng, seeded_rng};

type Failed = Box<dyn std::error::Error>;

/// What numbers in text are replaced by.
const WORDS: [&str; 16] = [
    "0",
    "-1",
    "1e999",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "-0.0",
    "9999999999999999999999",
    "",
    "\"\"",
    "null",
    "[]",
];

fn main() -> Result<ExitCode, Failed> {
    let arguments = Arguments::parse()?;
    let folder = tempfile::tempdir()?;
    let files = arguments.corpus(folder.path())?;
    if arguments.keep.is_none() {
        std::panic::set_hook(Box::new(|_| {}));
    }
    let mut rng = seeded_rng(arguments.seed, 0);
    let mut tally = Tally::default();
    let end = Instant::now() + Duration::from_secs(arguments.seconds);
    while Instant::now() < end {
        let at = rng.random_range(0..files.len());
        let (place, whole) = &files[at];
        fs::write(place, damaged(whole, &files[rng.random_range(0..files.len())].1, &mut rng))?;
        let start = Instant::now();
        let outcome = catch_unwind(|| read(&arguments.reader, &files[0].0));
        tally.add(outcome.ok(), start.elapsed(), place, arguments.keep.as_deref())?;
        fs::write(place, whole)?;
    }
    println!("{}: {tally}", arguments.reader);
    Ok(if tally.panics == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

struct Arguments {
    reader: String,
    seconds: u64,
    files: Vec<PathBuf>,
    seed: u64,
    keep: Option<PathBuf>,
}

impl Arguments {
    fn parse() -> Result<Self, Failed> {
        let mut given: Vec<String> = std::env::args().skip(1).collect();
        let seed = taken(&mut given, "--seed").map_or(Ok(1), |seed| seed.parse())?;
        let keep = taken(&mut given, "--keep").map(PathBuf::from);
        let [reader, seconds, files @ ..] = &given[..] else { return Err("usage: damage_files READER SECONDS".into()) };
        let files = files.iter().map(PathBuf::from).collect();
        Ok(Self { reader: reader.clone(), seconds: seconds.parse()?, files, seed, keep })
    }

    /// The files that are damaged, in `folder`, each with its whole content; the first is the one that is read.
    fn corpus(&self, folder: &Path) -> Result<Vec<(PathBuf, Vec<u8>)>, Failed> {
        let mut places: Vec<PathBuf> = Vec::new();
        for file in &self.files {
            let place = folder.join(file.file_name().ok_or("a FILE without a name")?);
            fs::copy(file, &place)?;
            places.push(place);
        }
        if places.is_empty() {
            places = written(&self.reader, folder)?;
        }
        places.into_iter().map(|place| Ok((place.clone(), fs::read(place)?))).collect()
    }
}

/// An option and its value, taken out of the arguments.
fn taken(given: &mut Vec<String>, name: &str) -> Option<String> {
    let at = given.iter().position(|argument| argument == name)?;
    given.remove(at);
    (at < given.len()).then(|| given.remove(at))
}

/// The golden model in the reader's format.
fn written(reader: &str, folder: &Path) -> Result<Vec<PathBuf>, Failed> {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/models/colmap_binary");
    let (mut model, _) = model::read(&golden)?;
    let (format, name) = match reader {
        "colmap-text" => (Format::ColmapText, "model"),
        "colmap-binary" => (Format::ColmapBinary, "model"),
        "openmvg" => (Format::OpenMvg, "sfm_data.json"),
        "opensfm" => (Format::OpenSfm, "reconstruction.json"),
        "nerfstudio" => (Format::Nerfstudio, "transforms.json"),
        "nvm" => (Format::Nvm, "model.nvm"),
        "bundler" => (Format::Bundler, "bundle.out"),
        "tum" | "kitti" => return camera_path(reader, folder),
        _ => return Err(format!("{reader} needs a FILE").into()),
    };
    if matches!(format, Format::Nvm | Format::Bundler) {
        let simple = |camera: &mut tractrix::camera::Camera| {
            *camera = tractrix::camera::Camera::with_focal(camera.width, camera.height, camera.focal[0]);
        };
        model.cameras.values_mut().for_each(simple);
        model.camera_forms.clear();
    }
    model::write(&folder.join(name), &model, format)?;
    Ok(model::files_of(&folder.join(name), format))
}

fn camera_path(reader: &str, folder: &Path) -> Result<Vec<PathBuf>, Failed> {
    let path = folder.join("path.txt");
    let line = if reader == "tum" { "1.5 1 2 3 0 0 0 1\n" } else { "1 0 0 0.5 0 1 0 2 0 0 1 3\n" };
    fs::write(&path, format!("# a path\n{}", line.repeat(20)))?;
    Ok(vec![path])
}

/// Whether the reader takes what lies there.
fn read(reader: &str, place: &Path) -> bool {
    match reader {
        "ply" => ply::read_mesh(place).is_ok(),
        "bal" => bal::read(place).is_ok(),
        "trajectories" => trajectories::read(place).is_ok(),
        "tracks" => tracks::read(place).is_ok(),
        "ground" => ground::read(place).is_ok(),
        "mask" => {
            let _ = masks::read_label_map(place, (960, 540));
            masks::read_mask_of_any_size(place).is_ok()
        }
        "sequence" => place.parent().is_some_and(|folder| Sequence::open(folder).is_ok()),
        _ => model::read(place).is_ok_and(|(model, _)| comes_back(place, &model)),
    }
}

/// What was read can be written, and is then read as the same, or is refused with a reason other than a number that no
/// reader may let in.
fn comes_back(place: &Path, model: &tractrix::scene::Reconstruction) -> bool {
    let copy = place.with_extension("copy");
    match colmap::write_binary(&copy, model) {
        Ok(()) => assert_eq!(&colmap::read_any(&copy).expect("what was written is readable").images, &model.images),
        Err(refused) => assert!(!refused.to_string().contains("is not finite"), "{refused}"),
    }
    let _ = fs::remove_dir_all(copy);
    true
}

/// A copy with one to six faults: bytes changed, taken out, doubled, cut off, put in from another file, or a number in
/// text that is another one.
fn damaged(whole: &[u8], other: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..rng.random_range(1..=6) {
        let length = bytes.len();
        if length == 0 {
            break;
        }
        let start = rng.random_range(0..length);
        let end = (start + 1 + rng.random_range(0..64usize)).min(length);
        match rng.random_range(0..9) {
            0 => bytes[start] = rng.random(),
            1 => bytes[start] ^= 1 << rng.random_range(0..8),
            2 => bytes.truncate(start),
            3 => drop(bytes.drain(start..end)),
            4 => drop(bytes.splice(start..start, bytes[start..end].to_vec())),
            5 => bytes[start..end].fill(if rng.random() { 0 } else { 255 }),
            6 => {
                let from = rng.random_range(0..other.len().max(1)).min(other.len());
                let to = (from + rng.random_range(0..64usize)).min(other.len());
                drop(bytes.splice(start..end, other[from..to].iter().copied()));
            }
            _ => number_replaced(&mut bytes, start, rng),
        }
    }
    bytes
}

/// Puts one of [`WORDS`] in the place of the next number.
fn number_replaced(bytes: &mut Vec<u8>, from: usize, rng: &mut Rng) {
    let is_part = |byte: &u8| byte.is_ascii_digit() || b".-+eE".contains(byte);
    let Some(start) = bytes[from..].iter().position(u8::is_ascii_digit).map(|at| from + at) else { return };
    let end = bytes[start..].iter().position(|byte| !is_part(byte)).map_or(bytes.len(), |at| start + at);
    let word = WORDS[rng.random_range(0..WORDS.len())];
    drop(bytes.splice(start..end, word.bytes()));
}

#[derive(Default)]
struct Tally {
    read: u64,
    accepted: u64,
    panics: u64,
    slowest: Duration,
}

impl Tally {
    /// `outcome` is `None` after a panic.
    fn add(&mut self, outcome: Option<bool>, took: Duration, place: &Path, keep: Option<&Path>) -> std::io::Result<()> {
        self.read += 1;
        self.accepted += u64::from(outcome == Some(true));
        if outcome.is_none() {
            self.panics += 1;
            kept(place, keep, &format!("panic-{}", self.panics))?;
        }
        if took > self.slowest {
            self.slowest = took;
            kept(place, keep, "slowest")?;
        }
        Ok(())
    }
}

fn kept(place: &Path, keep: Option<&Path>, as_what: &str) -> std::io::Result<()> {
    let Some(folder) = keep else { return Ok(()) };
    fs::create_dir_all(folder)?;
    let name = place.file_name().unwrap_or_default().to_string_lossy();
    fs::copy(place, folder.join(format!("{as_what}-{name}"))).map(drop)
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (refused, slowest_ms) = (self.read - self.accepted - self.panics, self.slowest.as_secs_f64() * 1e3);
        write!(f, "{} read, {} accepted, {refused} refused, ", self.read, self.accepted)?;
        write!(f, "{} panics, slowest {slowest_ms:.1} ms, largest memory {} MiB", self.panics, peak_mib())
    }
}

/// The largest resident memory of this process.
fn peak_mib() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse().ok());
    peak.map_or(0, |kib: u64| kib / 1024)
}
