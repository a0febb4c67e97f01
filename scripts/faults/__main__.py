#!/usr/bin/env python3
"""Brings faults upon the program, and sees what it makes of them.

    python3 scripts/faults KIND [--program FILE] [--seed N] [--number N] [--record]

KIND is one of those that `--help` lists. Every kind prints what failed and a summary; `--record` puts that into the
table of docs/reliability.md. Needs nothing but Python's standard library; kinds that say so need strace or unshare.
The folder to work in is made in $TMPDIR, best in memory. Ctrl-C and SIGTERM end a kind early: what was tried until then
counts. Exit code 1 if anything failed.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import damage
import defects
import inputs
import links
import power
import processes
import resources
from common import ROOT, Bench, Tally, append_row, commit

KINDS = {
    "defects": (defects.work, "every defect that was ever found"),
    "kills": (processes.kills, "SIGKILL at random moments; --number kills"),
    "kills-networks": (processes.kills_networks, "the same with the program's networks"),
    "kills-changes": (processes.kills_changes, "the same while options change"),
    "signals": (processes.signals, "SIGINT, SIGTERM, SIGHUP, SIGQUIT at several moments"),
    "locks": (processes.locks, "four processes on one folder"),
    "crash-points": (processes.crash_points, "SIGKILL at every rename, unlink and mkdir (strace)"),
    "failing-calls": (processes.failing_calls, "writes, synchronisations and renames that fail (strace)"),
    "order": (processes.order, "what reaches the disk before what (strace)"),
    "power": (power.power, "power failures at --number moments, by what had reached the disk (strace)"),
    "disk": (resources.disk, "file systems that are too small (unshare)"),
    "memory": (resources.memory, "too little address space"),
    "descriptors": (resources.descriptors, "too few descriptors"),
    "file-sizes": (resources.file_sizes, "a limit of the size of files"),
    "rights": (resources.rights, "places that cannot be written to"),
    "damaged-video": (inputs.damaged_video, "videos with damage of eight kinds; --number videos"),
    "damaged-network": (damage.networks, "networks and their descriptions, damaged; --number of them"),
    "damaged-folder": (damage.folders, "files of a finished folder, damaged; --number of them"),
    "pictures": (inputs.odd_pictures, "frames and masks of odd kinds, sizes and names"),
    "options": (inputs.options, "every number of the options at every extreme; --number cases"),
    "links": (links.links, "a link in the place of everything that a run leaves"),
}


def main() -> int:
    """Runs one kind."""
    kinds = "\n".join(f"  {name:14} {what}" for name, (_, what) in KINDS.items())
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=f"kinds:\n{kinds}", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--program", type=Path, default=ROOT / "target" / "release" / "tractrix")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, help="how many are tried")
    parser.add_argument("--only", action="append", default=[], help="names that begin so")
    parser.add_argument("--commit", default=commit(), help="what the program was built from [default: what is here]")
    parser.add_argument("--record", action="store_true", help="put the summary into docs/reliability.md")
    arguments = parser.parse_args()
    # Who starts this in the background may have signals ignored, and the program under trial would ignore them, too.
    for ends in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ends, signal.default_int_handler)
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        bench = Bench(arguments.program.resolve(), Path(folder), arguments.seed, arguments.number)
        try:
            tally: Tally = KINDS[arguments.kind][0](bench, arguments.only)
        except KeyboardInterrupt:
            if not Tally.latest:
                raise
            tally = Tally.latest
            tally.remark = ", ".join(filter(None, [tally.remark, "not all of them"]))
    print(tally.row(arguments.commit))
    if arguments.record:
        append_row(tally, arguments.commit)
    return 1 if tally.failures else 0


if __name__ == "__main__":
    sys.exit(main())
