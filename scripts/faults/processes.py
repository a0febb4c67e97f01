"""Processes that end at the wrong moment, and the order in which things reach the disk."""

from __future__ import annotations

import os
import random
import re
import signal
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import strace
from common import DEMO, DONE, INTERRUPTED, TRY_AGAIN, Bench, Outcome, Tally, differences, leftovers, result, run

# Options between which the runs of a kill test change.
CHANGES: list[list[str]] = [
    [],
    ["--every", "2"],
    ["--scale-method", "intersection"],
    ["--set", "background.mapper.max_error_px=3"],
    ["--set", "ground.num_neighbors=40"],
    ["--seed", "5"],
    ["--only-object", "1"],
    ["--set", "model_files=binary"],
]


@dataclass
class Work:
    """A command, what it leaves where nobody disturbs it, and how long that takes."""

    bench: Bench
    arguments: list[str | Path]
    expected: dict[str, str] = field(default_factory=dict)
    wall_s: float = 0.0

    def command(self, output: Path) -> list[str | Path]:
        """The command for an output folder."""
        return [*self.arguments, "--output", output]

    def once(self, output: Path, **how: object) -> Outcome:
        """Runs it."""
        return self.bench.run(*self.command(output), **how)

    def undisturbed(self) -> Work:
        """Runs it in peace, to know what comes of it."""
        output = self.bench.path("out")
        outcome = self.once(output)
        assert outcome.code == DONE, outcome.stderr
        self.expected, self.wall_s = result(output), outcome.wall_s
        return self

    def ends_the_same(self, output: Path) -> tuple[str | None, Outcome]:
        """Runs it to its end after it was disturbed, and compares."""
        outcome = self.once(output)
        if outcome.code != DONE:
            return outcome.described(), outcome
        other = differences(self.expected, result(output))
        left = leftovers(output)
        problem = f"differs: {other[:5]}" if other else f"left: {left[:5]}" if left else None
        return problem, outcome


def with_masks(bench: Bench, *more: str) -> Work:
    """A short run with given masks."""
    given = ["--masks", DEMO / "masks", "--end", "8f", "--max-dimension", "320", "--threads", "1"]
    return Work(bench, ["run", DEMO / "video.mp4", *given, *more])


def with_networks(bench: Bench) -> Work:
    """A short run in which the program's own networks look for vehicles."""
    small = ["--end", "6f", "--max-dimension", "320", "--threads", "1", "--set", "detector.input_size=320"]
    return Work(bench, ["run", DEMO / "video.mp4", *small])


def kills(bench: Bench, only: list[str]) -> Tally:
    """SIGKILL at random moments, one to six times a trial, until so many are counted: given masks."""
    return _kills(bench, with_masks(bench).undisturbed())


def kills_networks(bench: Bench, only: list[str]) -> Tally:
    """The same with the program's networks."""
    return _kills(bench, with_networks(bench).undisturbed())


def _kills(bench: Bench, work: Work) -> Tally:
    tally, rng, trial = Tally(bench.seed), random.Random(bench.seed), 0
    while tally.tried < (bench.number or 100):
        output, trial = bench.path("out"), trial + 1
        moments = [rng.uniform(0.0, work.wall_s) for _ in range(rng.randint(1, 6))]
        landed = _killed(work, output, moments, tally)
        problem, outcome = work.ends_the_same(output)
        tally.add(f"trial {trial}, {len(moments)} kills", problem, outcome)
        tally.tried += max(landed - 1, 0)
    return tally


def _killed(work: Work, output: Path, moments: list[float], tally: Tally) -> int:
    """Kills the command at each moment in turn; gives how many of the kills came before its end."""
    landed = 0
    for moment in moments:
        outcome = work.once(output, after=(moment, signal.SIGKILL))
        landed += outcome.code == -signal.SIGKILL
        if outcome.code not in (DONE, -signal.SIGKILL):
            tally.failures.append(outcome.described())
    return landed


def kills_changes(bench: Bench, only: list[str]) -> Tally:
    """A finished folder, other options, and kills while they are applied."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    works = [with_masks(bench, *change).undisturbed() for change in CHANGES]
    trial = 0
    while tally.tried < (bench.number or 100):
        trial += 1
        output = bench.path("out")
        rng.choice(works).once(output)
        landed = 0
        for _ in range(rng.randint(1, 3)):
            work = rng.choice(works)
            landed += _killed(work, output, [rng.uniform(0.0, work.wall_s) for _ in range(rng.randint(1, 2))], tally)
        problem, outcome = work.ends_the_same(output)
        tally.add(f"trial {trial}", problem, outcome)
        tally.tried += max(landed - 1, 0)
    return tally


def signals(bench: Bench, only: list[str]) -> Tally:
    """SIGINT, SIGTERM, SIGHUP and SIGQUIT at several moments: how soon, with which code, and what comes of it."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    codes = {"SIGINT": INTERRUPTED, "SIGTERM": TRY_AGAIN, "SIGHUP": TRY_AGAIN, "SIGQUIT": -signal.SIGQUIT}
    for name, code in codes.items():
        for share in (0.1, 0.3, 0.5, 0.7, 0.9):
            output, moment = bench.path("out"), share * work.wall_s
            outcome = work.once(output, after=(moment, signal.Signals[name]))
            late_s = outcome.wall_s - moment
            if outcome.code == DONE:
                continue
            problem = f"ended with {outcome.code}" if outcome.code != code else None
            problem = problem or (f"took {late_s:.1f} s" if late_s > 2.0 else None)
            told = "same command resumes" in outcome.stderr or name == "SIGQUIT"
            problem = problem or (None if told else "does not say how to go on")
            again, after = work.ends_the_same(output)
            tally.add(f"{name} after {moment:.1f} s", problem or again, after)
    return tally


def crash_points(bench: Bench, only: list[str]) -> Tally:
    """SIGKILL on entering the n-th rename and unlink, for every n: each moment at which a folder could be half done."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    for call in ("rename", "renameat", "renameat2", "unlink", "unlinkat", "mkdir"):
        for place in range(1, (bench.number or 1000) + 1):
            output = bench.path("out")
            inject = ["-e", f"inject={call}:signal=SIGKILL:when={place}"]
            killed, calls = strace.traced(bench, work.command(output), options=inject)
            if killed.code == DONE:
                break
            problem, outcome = work.ends_the_same(output)
            tally.add(f"{call} {place}", problem or strace.problem(calls, output), outcome)
    return tally


def failing_calls(bench: Bench, only: list[str]) -> Tally:
    """Calls of the system that fail from some moment on: the disk is full, or broken."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    rng = random.Random(bench.seed)
    count = _calls(bench, work)
    for call, error in [
        ("write", "ENOSPC"),
        ("fsync", "EIO"),
        ("rename", "EIO"),
        ("mkdir", "EDQUOT"),
        ("unlink", "EIO"),
    ]:
        most = count.get(call, 0)
        for place in sorted(rng.sample(range(1, most + 1), min(most, bench.number or 8))):
            output = bench.path("out")
            inject = ["-e", f"inject={call}:error={error}:when={place}"]
            failed, calls = strace.traced(bench, work.command(output), calls=call, options=inject)
            problem = strace.problem(calls, output) if failed.is_clean else failed.described()
            again, outcome = work.ends_the_same(output)
            tally.add(f"{call} {place} of {most}: {error}", problem or again, outcome)
    return tally


def _calls(bench: Bench, work: Work) -> dict[str, int]:
    """How often each call is made."""
    log = bench.path("calls.txt")
    run(["strace", "-f", "-c", "-o", log, bench.program, *work.command(bench.path("out"))])
    found = re.findall(r"^\s*[\d.]+\s+[\d.]+\s+\d+\s+(\d+)(?:\s+\d+)?\s+(\w+)$", log.read_text(), re.MULTILINE)
    return {name: int(number) for number, name in found}


TEXT = re.compile(r'"((?:[^"\\]|\\.)*)"')
OPENED = re.compile(r"^\d+<([^>]*)>")
STAGES = [
    "frames",
    "segment",
    "features",
    "background",
    "motion",
    "track",
    "follow",
    "objects",
    "ground",
    "scale",
    "metric",
    "report",
]


@dataclass
class Disk:
    """What has been written and is not yet known to be on the disk."""

    output: str
    dirty: set[str] = field(default_factory=set)
    problems: list[str] = field(default_factory=list)
    num_renames: int = 0

    def see(self, name: str, arguments: str) -> None:
        """Takes a call that succeeded."""
        paths = [path.encode().decode("unicode_escape") for path in TEXT.findall(arguments)]
        opened = OPENED.match(arguments)
        if opened and name in ("write", "pwrite64", "writev", "ftruncate"):
            self.wrote(opened.group(1))
        elif opened and name in ("fsync", "fdatasync"):
            self.dirty.discard(opened.group(1))
        elif name in ("mkdir", "mkdirat", "unlink", "unlinkat", "rmdir") and paths:
            # What a folder is emptied by names it by an open descriptor.
            path = os.path.join(opened.group(1) if opened else "", paths[-1])
            self.dirty.discard(path)
            self.wrote(os.path.dirname(path))
        elif name in ("rename", "renameat", "renameat2") and len(paths) > 1:
            self.renamed(paths[0], paths[1])

    def wrote(self, path: str) -> None:
        """Something has changed that a power failure would undo."""
        scratch = f"{self.output}/.tractrix/tmp"
        if path.startswith(self.output) and path != scratch:
            self.dirty.add(path)

    def renamed(self, source: str, target: str) -> None:
        """What takes a name must be on the disk; a marker speaks for all that was done before it."""
        if not target.startswith(self.output):
            return
        self.num_renames += 1
        self.dirty = {path for path in self.dirty if os.path.dirname(path) != f"{self.output}/.tractrix/tmp"}
        below = [path for path in self.dirty if path == source or path.startswith(source + "/")]
        if "/.tractrix/tmp/" not in target:
            self.problems += [f"{target} takes its name before {path} is synchronised" for path in below]
        if target in {f"{self.output}/.tractrix/{stage}.json" for stage in STAGES}:
            open_ones = [path for path in self.dirty if "/.tractrix/tmp" not in path and path != source]
            self.problems += [f"{target} speaks for {path}, which is not synchronised" for path in open_ones]
        self.dirty -= set(below)
        for folder in (os.path.dirname(source), os.path.dirname(target)):
            self.wrote(folder)


def order(bench: Bench, only: list[str]) -> Tally:
    """Reads from strace's log whether every file is on the disk before it takes its name, and all before a marker."""
    tally, work, output = Tally(bench.seed), with_masks(bench), bench.path("out")
    written = "write,pwrite64,writev,ftruncate,fsync,fdatasync"
    for more in ([], ["--every", "2"]):
        outcome, calls = strace.traced(bench, [*work.command(output), *more], calls=written)
        disk = Disk(str(output))
        for found in map(strace.CALL.match, calls):
            if found and int(found.group(3)) >= 0:
                disk.see(found.group(1), found.group(2))
        for problem in sorted({*disk.problems, *filter(None, [strace.problem(calls, output)])}):
            print(f"FAILED {problem}")
            tally.failures.append(problem)
        tally.tried += disk.num_renames
        tally.peak_mib = max(tally.peak_mib, outcome.peak_mib)
    return tally


def _together(work: Work, output: Path, apart_s: float) -> list[int]:
    """Starts four processes on one folder, one after another; gives their exit codes, ascending."""
    outcomes: list[Outcome] = []
    threads = [threading.Thread(target=lambda: outcomes.append(work.once(output))) for _ in range(4)]
    for thread in threads:
        thread.start()
        time.sleep(apart_s)
    for thread in threads:
        thread.join()
    return sorted(outcome.code for outcome in outcomes)


def locks(bench: Bench, only: list[str]) -> Tally:
    """Several processes on one folder: one works, the others say that it is in use and are to be started again."""
    tally, work = Tally(bench.seed), with_masks(bench).undisturbed()
    for trial in range(bench.number or 5):
        output = bench.path("out")
        codes = _together(work, output, 0.02 * trial)
        problem = None if codes[0] == DONE and set(codes) <= {DONE, TRY_AGAIN} else f"ended with {codes}"
        again, outcome = work.ends_the_same(output)
        tally.add(f"trial {trial + 1}", problem or again, outcome)
    return tally
