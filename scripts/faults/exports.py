"""`export` and `summary`: killed, on folders that are damaged, and on words that want to be more than words."""

from __future__ import annotations

import csv
import io
import json
import random
import re
import shutil
import signal
from pathlib import Path

import strace
from common import DONE, Bench, Tally, differences, leftovers, result
from damage import damaged
from defects import finished
from inputs import HANG_S, judged

FORMATS = ("csv", "tum", "kitti", "gltf", "video", "colmap", "all", "csv,gltf,video")
# What spreadsheets take for a formula, terminals for an order, and pages for markup.
WORDS = (
    "=cmd|' /C calc'!A0",
    "+1+1",
    "-2+3",
    "@SUM(1)",
    "\x1b]0;title\x07",
    "\x1b[2J",
    "\x9b2J",
    "\u202etxt",
    "a\nb",
    "\r=1",
    "\t=1",
    '"',
    "<script>",
    "&amp;",
    "x" * 10_000,
    "",
    "NaN",
    "\0",
    "]]>",
)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def export(bench: Bench, only: list[str]) -> Tally:
    """Kills at random moments, then the same command to its end; and folders with damage, under strace."""
    tally, rng, whole = Tally(bench.seed), random.Random(bench.seed), finished(bench)
    expected: dict[str, tuple[dict[str, str], float]] = {}
    for number in range(bench.number or 60):
        name, run = rng.choice(FORMATS), bench.path("run")
        shutil.copytree(whole, run)
        command = ["export", run, "--format", name]
        if number % 2:
            file = rng.choice(sorted(path for path in run.rglob("*") if path.is_file()))
            file.write_bytes(damaged(file.read_bytes(), rng))
            outcome, calls = strace.traced(bench, command, time_limit_s=HANG_S)
            problem = judged(outcome) or strace.problem(calls, run)
            tally.add(f"{number}: {name}, {file.relative_to(run)} damaged", problem, outcome)
            continue
        if name not in expected:
            outcome = bench.run(*command)
            assert outcome.code == DONE, outcome.stderr
            expected[name] = result(run), outcome.wall_s
            shutil.rmtree(run)
            shutil.copytree(whole, run)
        undisturbed, wall_s = expected[name]
        ends = rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM])
        bench.run(*command, after=(rng.uniform(0.0, wall_s), ends))
        outcome = bench.run(*command)
        other, left = differences(undisturbed, result(run)), leftovers(run)
        problem = outcome.described() if outcome.code != DONE else f"differs: {other[:5]}" if other else None
        tally.add(f"{number}: {name}, {ends.name}", problem or (f"left: {left[:5]}" if left else None), outcome)
    return tally


def summary(bench: Bench, only: list[str]) -> Tally:
    """Folders of which one is damaged or has odd words in its results: a table without formulas and orders."""
    tally, rng, whole = Tally(bench.seed), random.Random(bench.seed), finished(bench)
    for number in range(bench.number or 60):
        place, table = bench.path("runs"), bench.folder / "table.csv"
        for name in ("first", "second"):
            shutil.copytree(whole, place / name)
        if number % 2:
            file = place / "second" / rng.choice(["run.json", "trajectories.json"])
            file.write_bytes(damaged(file.read_bytes(), rng))
            what = f"{file.name} damaged"
        else:
            word = rng.choice(WORDS)
            _say(place / "second", word)
            what = f"{word[:20]!r} for every word"
        form = rng.choice(["csv", "geojson"])
        command = ["summary", place, "--format", form]
        outcome, calls = strace.traced(bench, command, time_limit_s=HANG_S)
        problem = (
            judged(outcome) or strace.problem(calls) or _orders(outcome.stdout if form == "csv" else "", outcome.stderr)
        )
        table.unlink(missing_ok=True)
        again = bench.run(*command, "--output", table, time_limit_s=HANG_S)
        if not problem and (
            again.code != outcome.code or not table.exists() or CONTROL.search(again.stdout + again.stderr)
        ):
            problem = f"into a file: {again.described()!r}"
        tally.add(f"{number}: {form}, {what}", problem, outcome)
    return tally


def _say(run: Path, word: str) -> None:
    """Puts a word in the place of the vehicles' classes and of the input's name."""
    path = run / "trajectories.json"
    found = json.loads(path.read_text())
    for vehicle in found["objects"]:
        vehicle["class"] = word
    path.write_text(json.dumps(found))
    path = run / "run.json"
    found = json.loads(path.read_text())
    found.setdefault("input", {})["path"] = word
    path.write_text(json.dumps(found))


def _orders(table: str, stderr: str) -> str | None:
    """A formula in a cell of a table, or a control character."""
    for row in csv.reader(io.StringIO(table, newline="")):
        for cell in row:
            if cell[:1] in tuple("=+-@\t\r") and not _is_number(cell):
                return f"a formula: {cell[:40]!r}"
    found = CONTROL.search(table + stderr)
    return f"a control character: {found.group()!r}" if found else None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
