"""Power failures: what a disk may hold of a run at any moment, and whether the program goes on from it.

A run is traced with everything that it writes. The calls are replayed on a disk that keeps what reaches it and what
is only promised apart; at random moments power fails, the folder is made as the disk has it then, and the same command
must end with the same bytes. A failure leaves one of three states:

* `strict`: only what was synchronised, contents and names alike;
* `names`: all names that were given, moved and taken away, with contents only as far as they were synchronised;
* `ordered`: names up to a random one of those that are not on the disk yet; of other contents a part, zeros, or all.

Renames are whole or not there, as on every file system with a journal; nothing else is taken for granted.
"""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import strace
from common import DONE, Bench, Tally
from processes import Work, with_masks
from replay import Call, Disk

# Besides those that name files, which every trace has.
CALLS = "write,pwrite64,writev,ftruncate,fsync,fdatasync,syncfs,sync,copy_file_range,sendfile,fallocate"
STATES = ("strict", "names", "ordered")


def traced(bench: Bench, work: Work, output: Path, tally: Tally) -> list[Call]:
    """The successful calls of a run by which files change. Descriptors are told by what they are opened for next."""
    outcome, lines = strace.traced(bench, work.command(output), calls=CALLS, options=["-xx", "-s", str(1 << 24)])
    assert outcome.code == DONE, outcome.stderr
    tally.add("the trace itself", strace.problem(lines, output), outcome)
    found = [strace.CALL.match(line) for line in lines]
    calls = [Call(match.group(1), match.group(2), int(match.group(3))) for match in found if match]
    return [call for call in calls if call.result >= 0]


def power(bench: Bench, only: list[str]) -> Tally:
    """Power fails at random moments: in a first run, and in one that changes what an earlier one left."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    first, other = with_masks(bench).undisturbed(), with_masks(bench, "--every", "2").undisturbed()
    for work, before in ((first, None), (other, first)):
        _fails(bench, work, before, rng, tally)
    return tally


def _fails(bench: Bench, work: Work, before: Work | None, rng: random.Random, tally: Tally) -> None:
    output, start = bench.path("out"), bench.path("start")
    start.mkdir()
    if before:
        before.once(output)
        shutil.copytree(output, start, dirs_exist_ok=True)
    calls = traced(bench, work, output, tally)
    whole = replayed(calls, output, start)
    assert not whole.differences(output), f"the replay is not what happened: {whole.differences(output)}"
    for _ in range(bench.number or 40):
        moment = rng.randint(1, whole.num_changes)
        for state in STATES:
            replayed(calls, output, start, moment).fail(state, rng, bench.path("out"))
            problem, outcome = work.ends_the_same(output)
            tally.add(f"{'a change' if before else 'a first run'}, {moment}: {state}", problem, outcome)


def replayed(calls: list[Call], output: Path, start: Path, moment: int | None = None) -> Disk:
    """The disk after so many changes of an output folder that first held what `start` holds; after all, if `None`."""
    disk = Disk.of(output, start)
    for call in calls:
        if moment is not None and disk.num_changes >= moment:
            break
        disk.see(call)
    return disk
