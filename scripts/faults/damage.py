"""Damage to what is no video: networks, and the folder that an earlier run left."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from pathlib import Path

from common import DEMO, ROOT, Bench, Tally
from inputs import HANG_S, judged
from processes import CHANGES, with_masks

GOLDEN = ROOT / "tests" / "golden" / "networks"
NETWORKS = {
    "mask_rcnn.onnx": "--segmentation-model",
    "mask_rcnn_pasted.onnx": "--segmentation-model",
    "segformer.onnx": "--ground-model",
    "segformer.toml": "--ground-model",
}


def damaged(whole: bytes, rng: random.Random) -> bytes:
    """A copy with one to six bytes, or stretches of them, changed, taken out, doubled, cleared or cut off."""
    content = bytearray(whole)
    for _ in range(rng.randint(1, 6)):
        start = rng.randrange(len(content) + 1)
        end = min(start + rng.randint(1, 64), len(content))
        match rng.randrange(7):
            case 0 if start < len(content):
                content[start] = rng.randrange(256)
            case 1 | 2 if start < len(content):
                content[start] ^= 1 << rng.randrange(8)
            case 3:
                del content[start:]
            case 4:
                del content[start:end]
            case 5:
                content[start:start] = content[start:end]
            case _:
                content[start:end] = bytes([rng.choice([0, 255])]) * (end - start)
    return bytes(content)


def networks(bench: Bench, only: list[str]) -> Tally:
    """Networks, and descriptions beside them, with damage: refused by name, or run."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    for number in range(bench.number or 100):
        name, flag = rng.choice(sorted(NETWORKS.items()))
        folder = bench.path("networks")
        shutil.copytree(GOLDEN, folder)
        (folder / name).write_bytes(damaged((GOLDEN / name).read_bytes(), rng))
        given = [flag, folder / Path(name).with_suffix(".onnx")]
        given += ["--masks", DEMO / "masks"] if flag == "--ground-model" else []
        frames = ["--end", "3f", "--max-dimension", "160", "--threads", "1"]
        command = ["run", DEMO / "video.mp4", "--output", bench.path("out"), *frames, *given]
        outcome = bench.run(*command, time_limit_s=HANG_S)
        tally.add(f"{number}: {name}", judged(outcome), outcome)
    return tally


def folders(bench: Bench, only: list[str]) -> Tally:
    """A file of a finished folder with damage, and a run that changes something: it goes on, or names the file.

    Where it says what is to be deleted, that is done, and the run ends as if nothing had been.
    """
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    whole = bench.path("whole")
    with_masks(bench).once(whole)
    works = [with_masks(bench, *change).undisturbed() for change in CHANGES]
    for number in range(bench.number or 100):
        work, output = rng.choice(works), bench.path("out")
        shutil.copytree(whole, output)
        file = rng.choice(sorted(path for path in output.rglob("*") if path.is_file()))
        file.write_bytes(damaged(file.read_bytes(), rng))
        outcome = work.once(output, time_limit_s=HANG_S)
        problem = judged(outcome)
        cure = re.search(r"; delete (.*), and the stage", outcome.stderr)
        if not problem and cure:
            subprocess.run(["rm", "-r", cure.group(1)], check=True)
            problem, _ = work.ends_the_same(output)
        tally.add(f"{number}: {file.relative_to(output)}, then {work.arguments[-2:]}", problem, outcome)
    return tally
