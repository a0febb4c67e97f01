"""Files that are not what they seem: damaged videos, odd pictures, options that nobody can mean."""

from __future__ import annotations

import json
import os
import random
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

from common import DEMO, DONE, FAILED, WRONG_USE, Bench, Outcome, Tally
from defects import pictures, png

# No short run here takes as long, whatever its input.
HANG_S = 120.0
# Nor as much memory.
MOST_MIB = 1500.0
FRAMES = ["--end", "10f", "--max-dimension", "320", "--threads", "1"]


def judged(outcome: Outcome) -> str | None:
    """What is wrong with how a process ended that may succeed or refuse."""
    if not outcome.is_clean:
        return outcome.described()
    if outcome.code not in (DONE, FAILED, WRONG_USE):
        return f"ended with {outcome.code}"
    if outcome.peak_mib > MOST_MIB:
        return f"took {outcome.peak_mib:.0f} MiB"
    # A word that was given may be said again.
    return "says NaN" if "NaN" in outcome.stderr.replace('"NaN"', "") else None


def damaged_video(bench: Bench, only: list[str]) -> Tally:
    """Videos with bits turned, boxes damaged, holes, cuts, shifts and fields that lie."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    whole = (DEMO / "video.mp4").read_bytes()
    video = bench.folder / "damaged.mp4"
    for number in range(bench.number or 100):
        kind, content = damaged(whole, rng)
        video.write_bytes(content)
        outcome = bench.run("sfm", video, "--output", bench.path("out"), *FRAMES, time_limit_s=HANG_S)
        tally.add(f"{number}: {kind}", judged(outcome), outcome)
    return tally


def damaged(whole: bytes, rng: random.Random) -> tuple[str, bytes]:
    """A copy with damage of one kind, and its name."""
    content = bytearray(whole)
    head = whole.find(b"moov")
    kind = rng.choice(["bits", "index", "cut", "hole", "shift", "field", "tables", "doubled"])
    if kind == "bits":
        for _ in range(rng.choice([1, 10, 100, 1000])):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    elif kind == "index":
        for _ in range(rng.choice([1, 3, 10])):
            content[rng.randrange(head, len(content))] = rng.randrange(256)
    elif kind == "cut":
        del content[rng.randrange(len(content)) :]
    elif kind == "hole":
        start = rng.randrange(len(content))
        content[start : start + rng.choice([100, 10_000, 100_000])] = bytes(min(len(content) - start, 100))
    elif kind == "shift":
        start = rng.randrange(len(content))
        content[start:start] = bytes(rng.randrange(256) for _ in range(rng.choice([1, 4, 7, 100])))
    elif kind == "doubled":
        start = rng.randrange(len(content))
        content[start:start] = content[start : start + rng.choice([8, 1000, 50_000])]
    else:
        names = [
            b"stts",
            b"stsz",
            b"stco",
            b"stsc",
            b"ctts",
            b"stss",
            b"mdhd",
            b"tkhd",
            b"avcC",
            b"stsd",
            b"mvhd",
            b"elst",
        ]
        name = rng.choice(names)
        at = content.find(name)
        if at > 0:
            place = at + 4 + 4 * rng.randrange(1 if kind == "tables" else 0, 12)
            value = rng.choice([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 49_999_999, rng.getrandbits(32)])
            content[place : place + 4] = struct.pack(">I", value)
    return kind, bytes(content)


def odd_pictures(bench: Bench, only: list[str]) -> Tally:
    """Frames and masks of odd kinds, sizes and names."""
    tally = Tally(bench.seed)
    textured = lambda x, y: bytes([(x * 37 ^ y * 91) & 255, (x * y) & 255, 90])  # noqa: E731
    whole = png(160, 120, textured)
    odd: dict[str, Callable[[Path], object]] = {
        "empty": lambda path: path.write_bytes(b""),
        "cut": lambda path: path.write_bytes(whole[: len(whole) // 2]),
        "text": lambda path: path.write_text("no picture"),
        "1x1": lambda path: path.write_bytes(png(1, 1)),
        "60000x1": lambda path: path.write_bytes(png(60000, 1)),
        "1x60000": lambda path: path.write_bytes(png(1, 60000)),
        "promises 4294967295x4294967295": lambda path: path.write_bytes(_resized(whole, 0xFFFFFFFF, 0xFFFFFFFF)),
        "promises 50000x50000": lambda path: path.write_bytes(_resized(whole, 50_000, 50_000)),
        "promises 0x0": lambda path: path.write_bytes(_resized(whole, 0, 0)),
        "a bomb of 20000x20000": lambda path: path.write_bytes(png(20_000, 20_000, colour_type=0)),
        "grey": lambda path: path.write_bytes(png(160, 120, lambda x, y: bytes([(x * y) & 255]), 0)),
        "a link to itself": lambda path: path.symlink_to(path.name),
        "a dangling link": lambda path: path.symlink_to("nowhere"),
        "a pipe": os.mkfifo,
        "a folder": Path.mkdir,
        "/dev/zero": lambda path: path.symlink_to("/dev/zero"),
        "/dev/full": lambda path: path.symlink_to("/dev/full"),
    }
    for name, make in odd.items():
        folder = pictures(bench, "frames", [f"{k}.png" for k in range(4)])
        make(folder / "4.png")
        outcome = bench.run("sfm", folder, "--output", bench.path("out"), "--fps", "9", time_limit_s=HANG_S)
        told = None if "4.png" in outcome.stderr or name == "grey" else "says nothing of 4.png"
        tally.add(f"a frame: {name}", judged(outcome) or told, outcome)
        masks = bench.path("masks")
        masks.mkdir()
        for k in range(8):
            shutil.copy(DEMO / "masks" / f"{k:05}.png", masks)
        (masks / "00004.png").unlink()
        make(masks / "00004.png")
        command = [part if part != DEMO / "masks" else masks for part in bench.command(bench.path("out"))]
        outcome = bench.run(*command, time_limit_s=HANG_S)
        told = None if "00004.png" in outcome.stderr else "says nothing of 00004.png"
        tally.add(f"a mask: {name}", judged(outcome) or told, outcome)
    return tally


def _resized(picture: bytes, width: int, height: int) -> bytes:
    """A PNG whose header promises another size."""
    import zlib

    head = b"IHDR" + struct.pack(">II", width, height) + picture[24:29]
    return picture[:12] + head + struct.pack(">I", zlib.crc32(head)) + picture[33:]


EXTREMES = [0, -1, 1, 2, 1e-308, 1e-9, 1e9, 1e308, -1e308, 2**31 - 1, 2**32 - 1, 2**53, 2**64 - 1, "NaN", None]


def options(bench: Bench, only: list[str]) -> Tally:
    """Every number of the options tree at every extreme: refused by name, or a short run that does no harm."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    told = subprocess.run([bench.program, "options", "--json"], capture_output=True, text=True, check=True).stdout
    tree = json.loads(told)
    tree = tree.get("options", tree)
    cases = [(path, value) for path in numbers(tree) for value in EXTREMES]
    rng.shuffle(cases)
    file = bench.folder / "options.json"
    num_refused = 0
    for path, value in cases[: bench.number or len(cases)]:
        changed = json.loads(json.dumps(tree))
        place = changed
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        file.write_text(json.dumps(changed))
        command = ["run", DEMO / "video.mp4", "--output", bench.path("out"), "--masks", DEMO / "masks", *FRAMES]
        outcome = bench.run(*command, "--options", file, time_limit_s=HANG_S)
        num_refused += outcome.code == WRONG_USE
        tally.add(f"{'.'.join(map(str, path))} = {value}", judged(outcome), outcome)
    tally.remark = f"{num_refused} of them refused"
    return tally


def numbers(tree: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The paths of all numbers of a tree."""
    if isinstance(tree, dict):
        return [found for key, value in tree.items() for found in numbers(value, (*path, key))]
    if isinstance(tree, list):
        return [found for key, value in enumerate(tree) for found in numbers(value, (*path, key))]
    return [path] if isinstance(tree, (int, float)) and not isinstance(tree, bool) else []
