"""`batch` among faults: lists that change, processes that are killed, several at once, and lists that are none."""

from __future__ import annotations

import contextlib
import os
import random
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import strace
from common import DEMO, DONE, FAILED, TRY_AGAIN, WRONG_USE, Bench, Outcome, Tally, differences, leftovers, result
from damage import damaged
from inputs import HANG_S, judged
from processes import with_masks

NAMES = ("one", "two", "three")
# How long processes may live on whose parent was killed.
ORPHANED_S = 5.0
SAID = re.compile(r"^\[\d+/\d+\] (\S+) done", re.MULTILINE)
# So many lines are listed in a moment, and not in a minute.
MANY = 100_000


@dataclass
class Jobs:
    """A list of short jobs, and what each of them leaves where nobody disturbs it."""

    bench: Bench
    rng: random.Random
    given: list[str | Path] = field(default_factory=lambda: with_masks(Bench(Path(), Path())).arguments[2:])
    expected: dict[str, dict[str, str]] = field(default_factory=dict)
    wall_s: float = 0.0

    @property
    def list(self) -> Path:
        """The list."""
        return self.bench.folder / "list.txt"

    @property
    def output(self) -> Path:
        """The folder of all results."""
        return self.bench.folder / "jobs"

    def command(self, *how: str) -> list[str | Path]:
        """A command on the list."""
        return ["batch", self.list, "--output", self.output, *self.given, *how]

    def fresh(self, names: tuple[str, ...] = NAMES) -> None:
        """The list, and no results."""
        self.bench.path("jobs")
        self.list.write_text("".join(f"{DEMO / 'video.mp4'}\t--name {name}\n" for name in names))

    def undisturbed(self) -> Jobs:
        """Does the jobs in peace."""
        self.fresh()
        outcome = self.bench.run(*self.command("--jobs", "2"))
        assert outcome.code == DONE, outcome.stderr
        self.expected = {name: result(self.output / name) for name in NAMES}
        self.wall_s = outcome.wall_s
        return self

    def start(self) -> subprocess.Popen[str]:
        """Starts all jobs."""
        command = [self.bench.program, *self.command("--jobs", "2", "--progress", "plain")]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(list(map(str, command)), text=True, start_new_session=True, **pipes)

    def some_time(self) -> None:
        """Waits for a random moment."""
        time.sleep(self.rng.uniform(0.0, self.wall_s))

    def ends_the_same(self) -> tuple[str | None, Outcome]:
        """Does what is left, and compares."""
        outcome = self.bench.run(*self.command("--jobs", "2"))
        if outcome.code != DONE:
            return f"then {outcome.described()}", outcome
        status = self.bench.run(*self.command("--status"))
        if status.code != DONE:
            return f"all is done, and --status ends with {status.code}", outcome
        for name in NAMES:
            other = differences(self.expected[name], result(self.output / name))
            if other or leftovers(self.output / name):
                return f"{name} differs: {other[:5]}, left {leftovers(self.output / name)[:5]}", outcome
        return None, outcome


def _end(process: subprocess.Popen[str]) -> tuple[int, str]:
    try:
        _, stderr = process.communicate(timeout=HANG_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return -signal.SIGKILL, "it hangs"
    return process.returncode, stderr


def _below(pid: int) -> list[int]:
    """The children of a process."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(path.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(path.parent.name))
    return found


def _list_changes(jobs: Jobs) -> tuple[str | None, Outcome]:
    process = jobs.start()
    jobs.some_time()
    lines = jobs.list.read_text().splitlines()
    extra = f"{DEMO / 'video.mp4'}\t--name extra"
    changed = jobs.rng.choice([[extra, *lines], lines[1:], lines[::-1], ["# none"], [*lines, extra]])
    jobs.list.write_text("\n".join(changed) + "\n")
    _, said = _end(process)
    claimed = [name for name in SAID.findall(said) if not (jobs.output / name / "report.html").exists()]
    problem = f"says that {claimed} are done" if claimed else None
    shutil.rmtree(jobs.output / "extra", ignore_errors=True)
    jobs.list.write_text("\n".join(lines) + "\n")
    again, outcome = jobs.ends_the_same()
    return problem or again, outcome


def _parent_is_killed(jobs: Jobs) -> tuple[str | None, Outcome]:
    process = jobs.start()
    jobs.some_time()
    children = _below(process.pid)
    process.kill()
    process.communicate()
    end = time.monotonic() + ORPHANED_S
    while time.monotonic() < end and any(Path(f"/proc/{child}").exists() for child in children):
        time.sleep(0.02)
    orphans = [child for child in children if Path(f"/proc/{child}").exists()]
    again, outcome = jobs.ends_the_same()
    return again or (f"{len(orphans)} jobs live on" if orphans else None), outcome


def _child_is_killed(jobs: Jobs) -> tuple[str | None, Outcome]:
    process = jobs.start()
    jobs.some_time()
    children = _below(process.pid)
    if children:
        with contextlib.suppress(ProcessLookupError):
            os.kill(jobs.rng.choice(children), signal.SIGKILL)
    code, said = _end(process)
    problem = None if code in (DONE, TRY_AGAIN) else f"ended with {code}: {said[-200:]}"
    again, outcome = jobs.ends_the_same()
    return problem or again, outcome


def _is_asked_to_end(jobs: Jobs) -> tuple[str | None, Outcome]:
    process = jobs.start()
    jobs.some_time()
    process.send_signal(signal.SIGTERM)
    asked = time.monotonic()
    code, said = _end(process)
    late_s = time.monotonic() - asked
    problem = None if code in (DONE, TRY_AGAIN, -signal.SIGTERM) else f"ended with {code}: {said[-200:]}"
    problem = problem or (f"took {late_s:.1f} s to end" if late_s > 2.0 else None)
    again, outcome = jobs.ends_the_same()
    return problem or again, outcome


def _several_at_once(jobs: Jobs) -> tuple[str | None, Outcome]:
    processes = []
    for _ in range(jobs.rng.randint(2, 3)):
        processes.append(jobs.start())
        time.sleep(jobs.rng.uniform(0.0, 0.3 * jobs.wall_s))
    ends = [_end(process) for process in processes]
    odd = [said for code, said in ends if code not in (DONE, TRY_AGAIN)]
    again, outcome = jobs.ends_the_same()
    return f"one ends badly: {odd[0][-200:]}" if odd else again, outcome


def _no_vehicles(jobs: Jobs) -> tuple[str | None, Outcome]:
    alone = Jobs(
        jobs.bench, jobs.rng, ["--detector", "none", "--motion", "off", "--end", "4f", "--max-dimension", "320"]
    )
    alone.fresh()
    outcome = jobs.bench.run(*alone.command("--jobs", "2"))
    status = jobs.bench.run(*alone.command("--status"))
    problem = None if (outcome.code, status.code) == (DONE, DONE) else f"{outcome.described()}; {status.described()}"
    return problem, outcome


def _a_pipe_as_lock(jobs: Jobs) -> tuple[str | None, Outcome]:
    state = jobs.output / "two" / ".tractrix"
    state.mkdir(parents=True)
    os.mkfifo(state / "lock")
    how = jobs.rng.choice([("--status",), ("--jobs", "2"), ("--index", "1")])
    outcome = jobs.bench.run(*jobs.command(*how), time_limit_s=30.0)
    shutil.rmtree(jobs.output / "two")
    return outcome.described() if not outcome.is_clean else jobs.ends_the_same()[0], outcome


def _no_list(jobs: Jobs) -> tuple[str | None, Outcome]:
    whole = jobs.list.read_bytes()
    lines = [
        f"{DEMO / 'video.mp4'}\t--name ../out",
        f"{DEMO / 'video.mp4'}\t--output /tmp/out",
        "nowhere.mp4",
        "'",
        "x" * 100_000,
        f"{DEMO / 'video.mp4'}\t--name 'one",
        "/dev/zero",
        f"{DEMO / 'video.mp4'}\t--name one",
        "\t\t",
        "a\0b",
    ]
    odd = jobs.rng.choice(
        [
            damaged(whole, jobs.rng),
            whole + jobs.rng.choice(lines).encode() + b"\n",
            bytes(jobs.rng.choices(range(256), k=999)),
        ]
    )
    jobs.list.write_bytes(odd)
    how = jobs.rng.choice([("--status",), ("--jobs", "2"), ("--index", "1"), ("--index", "9")])
    outcome, calls = strace.traced(jobs.bench, jobs.command(*how), time_limit_s=HANG_S)
    problem = None if outcome.code in (DONE, FAILED, WRONG_USE, TRY_AGAIN) and outcome.is_clean else outcome.described()
    return problem or strace.problem(calls, jobs.output), outcome


def _many_lines(jobs: Jobs) -> tuple[str | None, Outcome]:
    jobs.fresh(tuple(f"job-{number}" for number in range(MANY)))
    outcome = jobs.bench.run(*jobs.command("--status"), time_limit_s=60.0)
    return judged(outcome), outcome


CASES: dict[str, Callable[[Jobs], tuple[str | None, Outcome]]] = {
    "the list changes": _list_changes,
    "the parent is killed": _parent_is_killed,
    "a job is killed": _child_is_killed,
    "SIGTERM": _is_asked_to_end,
    "several at once": _several_at_once,
    "no vehicles": _no_vehicles,
    "a pipe as lock": _a_pipe_as_lock,
    "a list that is none": _no_list,
    f"{MANY} lines": _many_lines,
}


def batch(bench: Bench, only: list[str]) -> Tally:
    """Each case in turn until so many are counted: nothing is said to be done that is not, and all ends the same."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    jobs = Jobs(bench, rng).undisturbed()
    names = [name for name in CASES if not only or any(name.startswith(wanted) for wanted in only)]
    for number in range(bench.number or 4 * len(names)):
        name = names[number % len(names)]
        jobs.fresh()
        problem, outcome = CASES[name](jobs)
        tally.add(f"{number}: {name}", problem, outcome)
    return tally
