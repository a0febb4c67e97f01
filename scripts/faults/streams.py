"""Standard streams that are closed, full, or have nobody at their other end."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path

from common import DEMO, DONE, FAILED, WRONG_USE, Bench, Tally
from defects import finished
from processes import with_masks

FORMS = ([], ["--json"], ["--quiet"], ["--verbose"], ["--progress", "plain"])


def _closed(stream: int) -> None:
    os.close(stream)


def _full(stream: int) -> None:
    os.dup2(os.open("/dev/full", os.O_WRONLY), stream)


def _broken(stream: int) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    os.dup2(writer, stream)


def _not_writable(stream: int) -> None:
    os.dup2(os.open("/dev/null", os.O_RDONLY), stream)


WAYS: dict[str, Callable[[int], None]] = {
    "closed": _closed,
    "full": _full,
    "broken": _broken,
    "not writable": _not_writable,
}
STREAMS = {"stdout": (1,), "stderr": (2,), "both": (1, 2), "all three": (0, 1, 2)}


def streams(bench: Bench, only: list[str]) -> Tally:
    """Commands with streams that cannot be used: they end as promised, and a run leaves what it leaves otherwise."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    work, done = with_masks(bench).undisturbed(), finished(bench)
    (bench.folder / "log.csv").write_text("time_s,latitude,longitude\n0,48.5,9.25\n1,48.5001,9.25\n")
    cases = [(name, stream, way) for name in _commands(bench, done) for stream in STREAMS for way in WAYS]
    rng.shuffle(cases)
    for name, stream, way in cases[: bench.number or len(cases)]:
        output, form = bench.path("out"), rng.choice(FORMS)
        command = [*(work.command(output) if name == "run" else _commands(bench, done)[name]), *form]
        outcome = bench.run(
            *command, limits=lambda stream=stream, way=way: [WAYS[way](number) for number in STREAMS[stream]]
        )
        # A result that cannot be printed is a failure where stdout is what was asked for.
        problem = None if outcome.code in (DONE, FAILED, WRONG_USE) and outcome.is_clean else outcome.described()
        if name == "run":
            again = json.loads(bench.run(*work.command(output), "--json").stdout)
            # The page shows the command line, and is made again for another one.
            not_done = [stage for stage, how in again["stages"].items() if not how["reused"] and stage != "report"]
            problem = problem or (f"was not done: {not_done}" if not_done else work.ends_the_same(output)[0])
        tally.add(f"{name} {' '.join(form)}, {stream} {way}", problem, outcome)
    return tally


def _commands(bench: Bench, done: Path) -> dict[str, list[str | Path]]:
    return {
        "run": [],
        "wrong use": ["run", DEMO / "video.mp4"],
        "no video": ["run", bench.folder / "log.csv", "--output", bench.folder / "none"],
        "doctor": ["doctor"],
        "export": ["export", done, "--format", "all", "--output", bench.folder / "exported"],
        "summary": ["summary", done],
        "evaluate": ["evaluate", done, "--truth", DEMO],
        "telemetry": ["telemetry", bench.folder / "log.csv"],
        "options": ["options"],
        "help": ["--help"],
    }
