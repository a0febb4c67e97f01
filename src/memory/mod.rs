//! Memory limit: sizes that files declare are checked against it before memory is allocated.
//!
//! Without a limit of the user's it is a share of what there is: the machine's memory, or less where a control group
//! (a container, a batch system) gives less.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};

/// The share of the memory that there is which may be taken: the rest is the system's, and other programs'.
const SHARE: f64 = 0.8;
/// Where nobody can tell how much there is.
const UNKNOWN: u64 = 4 << 30;
/// Less holds no picture, and more has no machine.
const RANGE: std::ops::RangeInclusive<u64> = 64 << 20..=1 << 50;

/// A limit of memory, in bytes. As text a number with its unit: `2GiB`, `800MiB`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct MemoryLimit(u64);

impl MemoryLimit {
    /// The share of what there is, or the limit of this process.
    pub fn of_machine() -> Self {
        Self(of_machine())
    }

    /// In bytes.
    pub fn bytes(self) -> u64 {
        self.0
    }

    /// Refuses what needs more.
    ///
    /// # Errors
    /// [`TooMuch`] says how much it needs, and what to do.
    pub fn check(self, what: impl FnOnce() -> String, needed: u128) -> Result<(), TooMuch> {
        match needed <= u128::from(self.0) {
            true => Ok(()),
            false => Err(TooMuch { what: what(), needed: u64::try_from(needed).unwrap_or(u64::MAX), limit: self }),
        }
    }
}

/// Something that memory does not hold.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{what}: needs about {}, memory limit {limit}; raise --memory-limit",
    in_words(*needed)
)]
pub struct TooMuch {
    /// Subject, with the file and the remedy.
    pub what: String,
    /// Bytes.
    pub needed: u64,
    /// Limit.
    pub limit: MemoryLimit,
}

impl fmt::Display for MemoryLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        in_words(self.0).fmt(f)
    }
}

impl FromStr for MemoryLimit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}': expected an amount of memory such as 2GiB or 800MiB");
        let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
        let (number, unit) = text.split_at(end);
        let unit = match unit.trim() {
            "GiB" | "G" => 30,
            "MiB" | "M" => 20,
            "TiB" | "T" => 40,
            _ => return Err(wrong()),
        };
        let number: f64 = number.parse().map_err(|_| wrong())?;
        let bytes = (number * f64::from(1u32 << 20)) as u64;
        let bytes = bytes.checked_mul(1 << (unit - 20)).ok_or_else(wrong)?;
        match RANGE.contains(&bytes) {
            true => Ok(Self(bytes)),
            false => Err(format!("{text}: expected 64MiB to 1024TiB")),
        }
    }
}

impl TryFrom<String> for MemoryLimit {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<MemoryLimit> for String {
    /// Whole MiB, so that it reads back as the same.
    fn from(limit: MemoryLimit) -> Self {
        format!("{}MiB", limit.0 >> 20)
    }
}

/// The limit of this process, bytes; without one, all that there is.
static OF_PROCESS: AtomicU64 = AtomicU64::new(u64::MAX);

/// Lowers what this process may take, for all files that it reads. For programs: how much memory there is, is a matter
/// of the whole process.
pub fn limit_process(limit: MemoryLimit) {
    OF_PROCESS.fetch_min(limit.bytes(), Ordering::Relaxed);
}

/// The share of the machine's memory, and of the control group's, that may be taken, bytes: as it was when it was first
/// asked for, since every file that is read asks. Less where [`limit_process`] says so.
pub fn of_machine() -> u64 {
    static FOUND: OnceLock<u64> = OnceLock::new();
    (*FOUND.get_or_init(look)).min(OF_PROCESS.load(Ordering::Relaxed))
}

fn look() -> u64 {
    let meminfo = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let there_is = total(&meminfo).into_iter().chain(limits_of_groups(&groups, Path::new("/sys/fs/cgroup"))).min();
    there_is.map_or(UNKNOWN, |bytes| (bytes as f64 * SHARE) as u64)
}

/// An amount of memory for people.
pub fn in_words(bytes: u64) -> String {
    let mib = bytes as f64 / f64::from(1 << 20);
    match mib < 1024.0 {
        true => format!("{mib:.0} MiB"),
        false => format!("{:.1} GiB", mib / 1024.0),
    }
}

/// The machine's memory.
fn total(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib << 10)
}

/// Limits of control groups of version 1 and 2 for this process, with all groups above its own. A group that sets no
/// limit states `max`, or a number that no machine has.
fn limits_of_groups(groups: &str, root: &Path) -> Vec<u64> {
    let mut files = Vec::new();
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(group)) = (parts.next(), parts.next()) else { continue };
        let (base, file) = match controllers {
            "" => (root.to_path_buf(), "memory.max"),
            list if list.split(',').any(|name| name == "memory") => (root.join("memory"), "memory.limit_in_bytes"),
            _ => continue,
        };
        let own = base.join(group.trim_start_matches('/'));
        // In a container the group's own folder is the root, whatever it is called outside.
        let folders = own.ancestors().take_while(|folder| folder.starts_with(&base)).map(Path::to_path_buf);
        files.extend(folders.chain([base.clone()]).map(|folder: PathBuf| folder.join(file)));
    }
    files.iter().filter_map(|file| fs::read_to_string(file).ok()?.trim().parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_read_with_their_units_and_come_back() {
        let bytes = |text: &str| text.parse::<MemoryLimit>().map(MemoryLimit::bytes);
        assert_eq!((bytes("2GiB"), bytes("800MiB"), bytes("1.5 G")), (Ok(2 << 30), Ok(800 << 20), Ok(3 << 29)));
        for wrong in ["", "2", "GiB", "-1GiB", "1e9GiB", "nanGiB", "1KiB", "1MiB", "9999999999999999TiB", "2GiBs"] {
            assert!(bytes(wrong).is_err(), "{wrong}");
        }
        let limit: MemoryLimit = "1.5GiB".parse().unwrap();
        let text = serde_json::to_string(&limit).unwrap();
        assert_eq!((text.as_str(), serde_json::from_str(&text).ok()), ("\"1536MiB\"", Some(limit)));
    }

    #[test]
    fn what_needs_too_much_is_told_with_both_amounts() {
        let limit: MemoryLimit = "1GiB".parse().unwrap();
        assert!(limit.check(String::new, 1 << 30).is_ok());
        let said = limit.check(|| "a.onnx: its input".to_owned(), 120_000_000_000).unwrap_err().to_string();
        assert!(said.contains("a.onnx: its input: needs about 111.8 GiB") && said.contains("1.0 GiB"), "{said}");
        assert!(limit.check(String::new, u128::MAX).is_err());
    }

    #[test]
    fn the_narrowest_of_all_groups_counts() {
        let root = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| {
            let path = root.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        put("memory/memory.limit_in_bytes", "9223372036854771712\n");
        put("memory/batch/memory.limit_in_bytes", "4000000000\n");
        put("memory/batch/job/memory.limit_in_bytes", "8000000000\n");
        let first = "12:cpu,cpuacct:/\n4:memory:/batch/job\n0::/\n";
        assert_eq!(limits_of_groups(first, root.path()).iter().min(), Some(&4_000_000_000));
        put("memory.max", "max\n");
        put("pod/memory.max", "2000000000\n");
        assert_eq!(limits_of_groups("0::/pod/task\n", root.path()), [2_000_000_000]);
        assert_eq!(limits_of_groups("nonsense\n1:\n", root.path()), Vec::<u64>::new());
    }

    #[test]
    fn this_machine_has_memory() {
        assert!(RANGE.contains(&of_machine()), "{}", of_machine());
        assert_eq!(total("MemFree: 1 kB\nMemTotal:       1024 kB\n"), Some(1 << 20));
        assert_eq!((in_words(700 << 20), in_words(3 << 29)), ("700 MiB".to_owned(), "1.5 GiB".to_owned()));
    }
}
