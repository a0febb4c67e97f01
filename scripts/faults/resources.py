"""Too little of something: disk, memory, descriptors, and rights."""

from __future__ import annotations

import os
import resource
from pathlib import Path

from common import DONE, FAILED, Bench, Outcome, Tally, address_space, leftovers, run
from processes import Work, with_masks

# Where memory ends inside a library, the process may be ended; it must go on all the same.
ENDED_BY_SYSTEM = (-6, -9, -11, 127, 134)


def disk(bench: Bench, only: list[str]) -> Tally:
    """File systems that are too small, in bytes and in files; with room they go on."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    sizes = [f"size={size}" for size in ("100k", "200k", "300k", "400k", "600k", "800k", "1m", "2m", "8m")]
    for limit in [*sizes, *(f"nr_inodes={number}" for number in (5, 12, 30, 60, 300))]:
        mount = bench.path("small")
        mount.mkdir()
        first, second = _twice(bench, work, mount, limit)
        problem = None if first.code in (DONE, FAILED) and first.is_clean else first.described()
        if first.code == FAILED and "No space" not in first.stderr:
            problem = f"does not say what is wrong: {first.described()}"
        if first.code == FAILED and "run.json" in first.stderr.split("No space")[0]:
            problem = f"names run.json, which is written last: {first.described()}"
        if second.code != DONE:
            problem = problem or f"does not go on with room: {second.described()}"
        tally.add(limit, problem, first)
    return tally


def _twice(bench: Bench, work: Work, mount: Path, limit: str) -> tuple[Outcome, Outcome]:
    """Runs on a small file system, and once more when it has been made larger."""
    told = bench.path("first.txt")
    script = (
        f'mount -t tmpfs -o {limit} none {mount} && {{ "$@" 2> {told}; echo $? >> {told}; }}; '
        f'mount -o remount,size=64m,nr_inodes=10000 {mount}; "$@"'
    )
    shell = ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh"]
    second = run([*shell, bench.program, *work.command(mount / "out")])
    *lines, code = told.read_text().splitlines()
    return Outcome(int(code), "", "\n".join(lines), second.wall_s, second.peak_mib, False), second


def memory(bench: Bench, only: list[str]) -> Tally:
    """Address space that does not suffice: the process may end, but what it leaves must go on."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    for mib in (4096, 2048, 1024, 768, 640, 512, 448, 384, 320, 256, 192, 128, 64):
        output = bench.path("out")
        outcome = work.once(output, limits=address_space(mib))
        problem = None if outcome.is_clean or outcome.code in ENDED_BY_SYSTEM else outcome.described()
        again, _ = work.ends_the_same(output)
        tally.add(f"{mib} MiB", problem or again, outcome)
    return tally


def descriptors(bench: Bench, only: list[str]) -> Tally:
    """Few open files."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    for number in (1024, 64, 32, 16, 12, 10, 8, 7, 6, 5, 4):
        output = bench.path("out")
        outcome = work.once(
            output, limits=lambda number=number: resource.setrlimit(resource.RLIMIT_NOFILE, (number, number))
        )
        loader = "error while loading shared libraries" in outcome.stderr
        problem = None if outcome.is_clean or loader else outcome.described()
        again, _ = work.ends_the_same(output)
        tally.add(f"{number} descriptors", problem or again, outcome)
    return tally


def file_sizes(bench: Bench, only: list[str]) -> Tally:
    """A limit of the size of files, which the system holds by a signal."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    for size in (4 << 10, 100 << 10, 400 << 10, 1 << 20):
        output = bench.path("out")
        outcome = work.once(output, limits=lambda size=size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)))
        problem = None if outcome.is_clean or outcome.signal == "SIGXFSZ" else outcome.described()
        again, _ = work.ends_the_same(output)
        tally.add(f"{size >> 10} KiB", problem or again, outcome)
    return tally


def rights(bench: Bench, only: list[str]) -> Tally:
    """Folders that may not be written into, or are no folders."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    file = bench.path("file")
    file.write_text("x")
    places = {
        "a file": file,
        "below a file": file / "out",
        "in /proc": Path("/proc/tractrix"),
        "/dev/null": Path("/dev/null"),
    }
    if os.geteuid() != 0:
        locked = bench.path("locked")
        locked.mkdir(mode=0o500)
        places["a folder without rights"] = locked / "out"
    for name, output in places.items():
        outcome = work.once(output)
        problem = None if outcome.code in (FAILED, 2) and outcome.is_clean else outcome.described()
        tally.add(name, problem, outcome)
    left = leftovers(bench.folder)
    if left:
        tally.failures.append(f"left: {left}")
    return tally
