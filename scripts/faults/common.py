"""What all kinds of faults share: places to work in, the program under limits, results compared, and tallies."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "dataset" / "demo"
TABLE = ROOT / "docs" / "reliability.md"
# Exit codes that the program promises.
DONE, FAILED, WRONG_USE, TRY_AGAIN, INTERRUPTED = 0, 1, 2, 75, 130
# Longer than any run here takes on a slow machine.
TIME_LIMIT_S = 300.0
# What tells times, costs or where things lie differs between two runs of the same work.
UNSTABLE = {"wall_s", "cpu_s", "peak_rss_mib", "arguments", "path", "reused"}


@dataclass
class Outcome:
    """How a process ended."""

    code: int
    stdout: str
    stderr: str
    wall_s: float
    peak_mib: float
    timed_out: bool

    @property
    def signal(self) -> str | None:
        """The signal that ended it, by name."""
        return signal.Signals(-self.code).name if self.code < 0 else None

    @property
    def is_clean(self) -> bool:
        """Whether it ended by itself, with a promised code, and without a panic."""
        promised = self.code in (DONE, FAILED, WRONG_USE, TRY_AGAIN, INTERRUPTED)
        return promised and "panicked" not in self.stderr and not self.timed_out

    def described(self) -> str:
        """The end in a line: code or signal, and the last thing that was said."""
        end = "time limit" if self.timed_out else self.signal or f"exit {self.code}"
        said = [line for line in self.stderr.strip().splitlines() if line.strip()]
        return f"{end}: {said[-1] if said else ''}"


def run(
    command: list[str | Path],
    *,
    cwd: Path | None = None,
    limits: Callable[[], None] | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    environment: dict[str, str | None] | None = None,
    after: tuple[float, int] | None = None,
) -> Outcome:
    """Runs a process to its end.

    `limits` is called in the process before the program starts; `after` is a number of seconds and a signal to send
    then. Variables of `environment` that are `None` are removed.
    """
    variables = {**os.environ, **(environment or {})}
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        start = time.monotonic()
        process = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            cwd=cwd,
            preexec_fn=limits,
            env={name: value for name, value in variables.items() if value is not None},
            start_new_session=True,
        )
        expired = threading.Event()

        def send(number: int) -> None:
            # It may have ended a moment ago.
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, number)

        def end() -> None:
            expired.set()
            send(signal.SIGKILL)

        timers = [threading.Timer(time_limit_s, end)]
        if after:
            timers.append(threading.Timer(after[0], send, (after[1],)))
        for timer in timers:
            timer.daemon = True
            timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        for timer in timers:
            timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.monotonic() - start
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace"))
        return Outcome(process.returncode, *texts, wall_s, usage.ru_maxrss / 1024, expired.is_set())


def address_space(mib: int) -> Callable[[], None]:
    """A limit of address space for `run`."""
    return lambda: resource.setrlimit(resource.RLIMIT_AS, (mib << 20, mib << 20))


@dataclass
class Bench:
    """The program, and a folder to work in that goes at the end."""

    program: Path
    folder: Path
    seed: int = 1
    number: int | None = None

    def path(self, name: str) -> Path:
        """A fresh place: what was there is removed."""
        path = self.folder / name
        if path.is_symlink() or (path.exists() and not path.is_dir()):
            path.unlink()
        elif path.is_dir():
            shutil.rmtree(path)
        return path

    def run(self, *arguments: str | Path, **how: object) -> Outcome:
        """Runs the program."""
        return run([self.program, *arguments], **how)  # type: ignore[arg-type]

    def command(self, output: Path, *more: str | Path, frames: int = 8) -> list[str | Path]:
        """A short run with given masks, and its arguments."""
        given = ["--masks", DEMO / "masks", "--end", f"{frames}f", "--max-dimension", "480", "--threads", "1"]
        return ["run", DEMO / "video.mp4", "--output", output, *given, *more]


def result(output: Path) -> dict[str, str]:
    """Every file of an output folder, by name, with a hash of what two runs of the same work have in common."""
    found = {}
    for path in sorted(output.rglob("*")):
        if path.is_symlink() or not path.is_file():
            continue
        name = path.relative_to(output).as_posix()
        found[name] = hashlib.sha256(_stable(name, path.read_bytes())).hexdigest()
    return found


def _stable(name: str, content: bytes) -> bytes:
    if name == "report.html":
        return b"a page" if content.rstrip().endswith(b"</html>") else content
    if name == "run.json" or (name.startswith(".tractrix/") and name.endswith(".json")):
        return json.dumps(_without_unstable(json.loads(content)), sort_keys=True).encode()
    return content


def _without_unstable(value: object) -> object:
    if isinstance(value, dict):
        return {key: _without_unstable(inner) for key, inner in value.items() if key not in UNSTABLE}
    if isinstance(value, list):
        return [_without_unstable(inner) for inner in value]
    return value


def differences(expected: dict[str, str], found: dict[str, str]) -> list[str]:
    """Names that are missing, too many, or whose content differs."""
    return sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))


def leftovers(output: Path) -> list[str]:
    """Temporary files that are there although nobody is at work."""
    is_temporary = re.compile(r"^\.(tractrix-|tmp|report-)")
    names = [path for path in output.rglob("*") if is_temporary.match(path.name)]
    scratch = output / ".tractrix" / "tmp"
    return [str(path) for path in names] + ([str(path) for path in scratch.iterdir()] if scratch.is_dir() else [])


@dataclass
class Tally:
    """What was tried of a kind, and what failed."""

    latest: ClassVar[Tally | None] = None

    seed: int
    tried: int = 0
    failures: list[str] = field(default_factory=list)
    peak_mib: float = 0.0
    remark: str = ""

    def __post_init__(self) -> None:
        """The last one that was begun is known, for those who stop a kind before its end."""
        Tally.latest = self

    def add(self, name: str, problem: str | None, outcome: Outcome | None = None) -> None:
        """Counts a case; `problem` says what is wrong with it."""
        self.tried += 1
        if outcome:
            self.peak_mib = max(self.peak_mib, outcome.peak_mib)
        if problem:
            self.failures.append(f"{name}: {problem}")
            print(f"FAILED {name}: {problem}", flush=True)

    def row(self, kind: str, what: str, commit: str) -> str:
        """The row of the table in docs/reliability.md."""
        tested = ", ".join(filter(None, [what, self.remark]))
        counts = [f"{self.tried:,}", str(len(self.failures)), f"{self.peak_mib:.0f} MiB", str(self.seed)]
        return "| " + " | ".join([f"`{kind}`", tested, *counts, commit]) + " |"


def commit() -> str:
    """The commit of the source tree, `+` where it has changed since."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no", "--", "src", "Cargo.lock")
    return (git("rev-parse", "--short", "HEAD") or "unknown") + ("+" if changed else "")


def record(row: str) -> None:
    """Puts a row into the table of docs/reliability.md, in the place of an older one of the same kind."""
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("| Kind |")) + 2
    end = next(k for k in range(first, len(lines)) if not lines[k].startswith("|"))
    older = [k for k in range(first, end) if lines[k].split("|")[1] == row.split("|")[1]]
    start, stop = (older[0], older[0] + 1) if older else (end, end)
    lines[start:stop] = [row]
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")
