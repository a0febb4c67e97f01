"""Links in the output folder: nothing outside it may be written, truncated or removed through one."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

from common import WRONG_USE, Bench, Tally
from processes import with_masks


def links(bench: Bench, only: list[str]) -> Tally:
    """A link in the place of every file and folder that a run leaves, before the next one, with other options."""
    tally, work = Tally(bench.seed), with_masks(bench)
    whole = bench.path("whole")
    work.once(whole)
    places = sorted(path.relative_to(whole) for path in whole.rglob("*"))
    random.Random(bench.seed).shuffle(places)
    for place in places[: bench.number or len(places)]:
        out, elsewhere = bench.path("out"), bench.path("elsewhere")
        shutil.copytree(whole, out)
        target = elsewhere / "precious"
        if (whole / place).is_dir():
            shutil.copytree(whole / place, target)
            (target / "of-others.txt").write_text("precious")
            shutil.rmtree(out / place)
        else:
            elsewhere.mkdir()
            target.write_text("precious")
            (out / place).unlink()
        (out / place).symlink_to(target)
        before = content(elsewhere)
        outcome = work.once(out) if place.parts[0] == ".tractrix" else with_masks(bench, "--every", "2").once(out)
        problem = None if content(elsewhere) == before else "what the link leads to was changed"
        if not problem and outcome.code != WRONG_USE:
            problem = outcome.described()
        tally.add(str(place), problem, outcome)
    return tally


def content(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
