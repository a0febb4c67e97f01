#!/usr/bin/env python3
"""Renders the whole data set, 5 vehicles x 7 trajectories, or the scenarios, in the order in which it is useful.

Every trajectory comes with two vehicles before any comes with a third. Can be
stopped at any moment: the same command goes on where it was. Each sequence is
rendered by a process of its own.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tractrix_dataset.drives import TRAJECTORIES
from tractrix_dataset.scenarios import CHOSEN
from tractrix_dataset.vehicles.spec import VEHICLES

SCRIPT = Path(__file__).with_name("render.py")


def order() -> list[tuple[str, str]]:
    """(trajectory, vehicle) pairs: a different vehicle each time, all trajectories in every round."""
    trajectories, vehicles = list(TRAJECTORIES), list(VEHICLES)
    rounds = range(len(vehicles))
    return [(t, vehicles[(i + k) % len(vehicles)]) for k in rounds for i, t in enumerate(trajectories)]


ORDERS = {"seven": order, "scenarios": lambda: list(CHOSEN), "all": lambda: [*order(), *CHOSEN]}


def finished(folder: Path) -> bool:
    """Whether a sequence is whole: scene.json is written last."""
    return (folder / "scene.json").is_file()


def free_processors(passed: list[str]) -> deque[int]:
    """Processors to give to the renders, one each; none where a render has several threads.

    Blender's own pool has a thread for every processor that it may use, whatever --threads says, and those that have
    nothing to do ask for work all the time: a render that may use one processor only takes half the CPU time.
    """
    threads = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    threads.add_argument("--threads", type=int, default=0)
    one = threads.parse_known_args(passed)[0].threads == 1
    return deque(sorted(os.sched_getaffinity(0)) if one and hasattr(os, "sched_getaffinity") else [])


def render(folder: Path, trajectory: str, vehicle: str, passed: list[str], processors: deque[int]) -> bool:
    """Renders one sequence in a process of its own, on a processor of its own if one is free; whether that worked."""
    names = ["--trajectory", trajectory, "--vehicle", vehicle, "--output", str(folder)]
    try:
        own = processors.popleft()
    except IndexError:
        own = None
    process = subprocess.Popen([sys.executable, str(SCRIPT), *names, *passed])
    if own is not None:
        os.sched_setaffinity(process.pid, {own})
    worked = process.wait() == 0
    if own is not None:
        processors.append(own)
    return worked


def main() -> None:
    """Renders sequence by sequence; other options are passed on to render.py."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True, help="folder of all sequences")
    parser.add_argument("--list", action="store_true", help="only say what is there and what is missing")
    parser.add_argument("--set", choices=sorted(ORDERS), default="seven", help="what to render, default seven")
    parser.add_argument("--only", type=int, default=1000, help="stop after this many sequences in all")
    parser.add_argument("--processes", type=int, default=1, help="sequences rendered at a time, default 1")
    arguments, passed = parser.parse_known_args()
    missing = []
    for trajectory, vehicle in ORDERS[arguments.set]()[: arguments.only]:
        folder = arguments.output / f"{trajectory}_{vehicle}"
        whole = finished(folder)
        if arguments.list or whole:
            print(f"{folder.name}: {'there' if whole else 'missing'}", flush=True)
        if not whole:
            missing.append((folder, trajectory, vehicle))
    if arguments.list:
        return
    with ThreadPoolExecutor(max(1, arguments.processes)) as pool:
        processors = free_processors(passed)
        good = list(pool.map(lambda item: render(*item, passed, processors), missing))
    failed = [folder.name for (folder, *_), worked in zip(missing, good) if not worked]
    if failed:
        sys.exit(f"not rendered: {', '.join(failed)}")


if __name__ == "__main__":
    main()
