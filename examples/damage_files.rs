//! Damages files at random and reads them: no reader may panic, hang or take memory that the file does not need.
//!
//!     damage_files READER SECONDS [FILE...] [--seed N] [--keep DIR]
//!
//! READER is one of those in `tests/common/readers.rs`, or `all`, which gives each so much time; compiled with the
//! feature `telemetry`, logs are among them. Without FILEs
//! the reader's files are written there. What was read is written as a COLMAP model and read again. Run it under
//! `ulimit -v` to have memory that is asked for and not used count as well, and with `TMPDIR` in memory (`/dev/shm`):
//! every case is a file.
//!
//! Prints how many files were read, accepted and refused, panics, the slowest file, and the largest resident memory;
//! exit code 1 after a panic. With `--keep` panics are shown, and the files that panicked, and the slowest, stay.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use rand::Rng as _;
use readers::{Failed, damaged, read, readers as all, written};
use tractrix::math::seeded_rng;

#[path = "../tests/common/readers.rs"]
mod readers;

/// How often one file is damaged before another one is, each time from its whole content.
const TIMES_EACH: u32 = 32;

fn main() -> Result<ExitCode, Failed> {
    let arguments = Arguments::parse()?;
    if arguments.keep.is_none() {
        std::panic::set_hook(Box::new(|_| {}));
    }
    let readers = if arguments.reader == "all" { all() } else { vec![arguments.reader.as_str()] };
    let (mut num_read, mut num_panics) = (0, 0);
    for reader in &readers {
        let tally = arguments.rounds(reader)?;
        println!("{reader}: {tally}");
        (num_read, num_panics) = (num_read + tally.read, num_panics + tally.panics);
    }
    if readers.len() > 1 {
        println!("all: {num_read} read, {num_panics} panics, largest memory {} MiB", peak_mib());
    }
    Ok(if num_panics == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
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

    /// Damages and reads the files of one reader for as long as was asked.
    fn rounds(&self, reader: &str) -> Result<Tally, Failed> {
        let folder = tempfile::tempdir()?;
        let files = self.corpus(reader, folder.path())?;
        let (mut rng, mut tally) = (seeded_rng(self.seed, 0), Tally::default());
        let end = Instant::now() + Duration::from_secs(self.seconds);
        while Instant::now() < end {
            let target = &files[rng.random_range(0..files.len())];
            for _ in 0..TIMES_EACH {
                target.put(&damaged(&target.whole, &files[rng.random_range(0..files.len())].whole, &mut rng))?;
                let start = Instant::now();
                let outcome = catch_unwind(|| read(reader, &files[0].place));
                tally.add(outcome.ok(), start.elapsed(), &target.place, self.keep.as_deref())?;
            }
            target.put(&target.whole)?;
        }
        Ok(tally)
    }

    /// The files that are damaged, in `folder`; the first is the one that is read.
    fn corpus(&self, reader: &str, folder: &Path) -> Result<Vec<Target>, Failed> {
        let mut places: Vec<PathBuf> = Vec::new();
        for file in &self.files {
            let place = folder.join(file.file_name().ok_or("a FILE without a name")?);
            fs::copy(file, &place)?;
            places.push(place);
        }
        if places.is_empty() {
            places = written(reader, folder)?;
        }
        places.into_iter().map(Target::new).collect()
    }
}

/// A file that is damaged. It stays open: opening it for every case costs more than reading it.
struct Target {
    place: PathBuf,
    file: File,
    whole: Vec<u8>,
}

impl Target {
    fn new(place: PathBuf) -> Result<Self, Failed> {
        let (file, whole) = (File::options().write(true).open(&place)?, fs::read(&place)?);
        Ok(Self { place, file, whole })
    }

    /// Gives the file another content.
    fn put(&self, content: &[u8]) -> std::io::Result<()> {
        self.file.write_all_at(content, 0)?;
        self.file.set_len(content.len() as u64)
    }
}

/// An option and its value, taken out of the arguments.
fn taken(given: &mut Vec<String>, name: &str) -> Option<String> {
    let at = given.iter().position(|argument| argument == name)?;
    given.remove(at);
    (at < given.len()).then(|| given.remove(at))
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
