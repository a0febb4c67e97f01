"""Commands under strace: none may change anything outside its output folder, and none may ask for a socket."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import strace
from common import DEMO, DONE, ROOT, Bench, Tally
from defects import finished

Question = Callable[[list[str], Path], list[str]]
SMALL = ["--max-dimension", "320", "--threads", "1", "--set", "detector.input_size=320"]
LOG = "time_s,latitude,longitude\n0,48.5,9.25\n1,48.5001,9.25\n2,48.5002,9.25\n"
PERSONAL = {"HOME": "home", "TMPDIR": "tmp", "XDG_CACHE_HOME": "cache", "XDG_CONFIG_HOME": "config"}
# Names at which ONNX Runtime's telemetry was seen to write.
PLANTED = ("tmp/.ses", "cache/Microsoft", "home/.cache")


def writes(bench: Bench, only: list[str]) -> Tally:
    """Every command in every environment: what it changes lies in its output folder."""
    return _asked(bench, only, lambda calls, out: strace.changed_outside(calls, out))


def sockets(bench: Bench, only: list[str]) -> Tally:
    """The same commands: none asks for a socket."""
    return _asked(bench, only, lambda calls, _: strace.sockets(calls))


def _asked(bench: Bench, only: list[str], question: Question) -> Tally:
    tally, done = Tally(bench.seed), finished(bench)
    cases = [(command, name) for command in _commands(bench, Path()) for name in _environments(bench, Path())]
    random.Random(bench.seed).shuffle(cases)
    cases = [case for case in cases if not only or case[0] in only]
    for command, name in cases[: bench.number or len(cases)]:
        out, place = bench.path("out"), bench.path("place")
        shutil.copytree(done, out / "run")
        _personal(place, is_planted=name == "links are planted")
        environment = {
            **{key: str(place / folder) for key, folder in PERSONAL.items()},
            **_environments(bench, place)[name],
        }
        outcome, calls = strace.traced(bench, _commands(bench, out)[command], environment=environment)
        found = question(calls, out)
        problem = None if outcome.code == DONE else outcome.described()
        problem = problem or (f"{len(found)} calls, the first: {found[0][:200]}" if found else _left(place))
        tally.add(f"{command}, {name}", problem, outcome)
    return tally


def _personal(place: Path, *, is_planted: bool) -> None:
    """Empty folders of a user's own, or with links to a folder of somebody's at names that were once written to."""
    for name in (*PERSONAL.values(), "precious"):
        (place / name).mkdir(parents=True)
    for link in PLANTED if is_planted else ():
        target = place / "precious" / Path(link).name
        if link != "tmp/.ses":
            target.mkdir()
        (place / link).symlink_to(target)


def _left(place: Path) -> str | None:
    """Files that are in the folders of the user's own, or behind the links there."""
    found = [path for path in place.rglob("*") if path.is_file()]
    return f"left: {found[0]}" if found else None


def _environments(bench: Bench, place: Path) -> dict[str, dict[str, str | None]]:
    library = ROOT / "third_party" / "onnxruntime" / os.uname().machine / "libonnxruntime.so"
    return {
        "nothing set": {},
        "links are planted": {},
        "no folders of the user's own": dict.fromkeys(PERSONAL),
        "telemetry is asked for": {"ORT_DISABLE_TELEMETRY": "0"},
        "a build server": {"CI": "true", "GITHUB_ACTIONS": "true"},
        "the runtime is named": {"TRACTRIX_ONNXRUNTIME": str(library), "ORT_DISABLE_TELEMETRY": ""},
        "a proxy is named": {"https_proxy": "http://127.0.0.1:9", "http_proxy": "http://127.0.0.1:9"},
    }


def _commands(bench: Bench, out: Path) -> dict[str, list[str | Path]]:
    run, video = out / "run", DEMO / "video.mp4"
    if out != Path():
        (out / "log.csv").write_text(LOG)
        (out / "list.txt").write_text(f"{video}\n")
    of_list = ["batch", out / "list.txt", "--output", out / "jobs"]
    return {
        "run, networks": ["run", video, "--output", out / "new", "--end", "6f", *SMALL],
        "run, masks": ["run", video, "--output", out / "new", "--masks", DEMO / "masks", "--end", "6f", *SMALL],
        "run, a log": ["run", video, "--output", out / "new", "--end", "6f", "--telemetry", out / "log.csv", *SMALL],
        "sfm": ["sfm", video, "--output", out / "new", "--end", "6f", *SMALL],
        "batch --jobs": [*of_list, "--jobs", "1", "--end", "3f", *SMALL],
        "batch --index": [*of_list, "--index", "0", "--end", "3f", *SMALL],
        "doctor": ["doctor"],
        "doctor, a network": ["doctor", "--ground-model", ROOT / "tests/golden/networks/segformer.onnx"],
        "export": ["export", run, "--format", "all"],
        "summary": ["summary", run, "--output", out / "all.csv"],
        "evaluate": ["evaluate", run, "--truth", DEMO],
        "compare": ["compare", run / "background", run / "background"],
        "convert": ["convert", run / "background", out / "model", "--to", "colmap-binary"],
        "telemetry": ["telemetry", out / "log.csv"],
        "options": ["options", "--json"],
    }
