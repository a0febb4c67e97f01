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

import batch
import commands
import damage
import defects
import exports
import inputs
import links
import logs
import playlists
import power
import processes
import resources
import streams
from common import ROOT, Bench, Tally, commit, record

KINDS = {
    "defects": (defects.work, "defects found earlier"),
    "kills": (processes.kills, "SIGKILL at random moments"),
    "kills-networks": (processes.kills_networks, "the same, with networks"),
    "kills-changes": (processes.kills_changes, "the same, options changing"),
    "signals": (processes.signals, "SIGINT, SIGTERM, SIGHUP, SIGQUIT"),
    "locks": (processes.locks, "four processes on one folder"),
    "crash-points": (processes.crash_points, "SIGKILL at each rename, unlink, mkdir (strace)"),
    "failing-calls": (processes.failing_calls, "failing writes, synchronizations, renames (strace)"),
    "order": (processes.order, "order of writing (strace)"),
    "power": (power.power, "power failures (strace)"),
    "disk": (resources.disk, "full disks (unshare)"),
    "memory": (resources.memory, "little address space"),
    "descriptors": (resources.descriptors, "few descriptors"),
    "file-sizes": (resources.file_sizes, "limited file sizes"),
    "rights": (resources.rights, "unwritable places"),
    "damaged-video": (inputs.damaged_video, "damaged videos"),
    "damaged-network": (damage.networks, "damaged networks"),
    "damaged-folder": (damage.folders, "damaged results of an earlier run"),
    "pictures": (inputs.odd_pictures, "odd frames and masks"),
    "options": (inputs.options, "numeric options at extremes"),
    "links": (links.links, "links in place of results"),
    "writes": (commands.writes, "changes outside the output folder (strace)"),
    "sockets": (commands.sockets, "sockets (strace)"),
    "playlists": (playlists.playlists, "playlists as videos (strace)"),
    "telemetry": (logs.telemetry, "damaged and hostile logs (strace)"),
    "batch": (batch.batch, "changing lists, kills, several at once (strace)"),
    "export": (exports.export, "kills, damaged folders (strace)"),
    "summary": (exports.summary, "damaged folders, odd words (strace)"),
    "streams": (streams.streams, "closed, full, broken streams"),
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
    row = tally.row(arguments.kind, KINDS[arguments.kind][1], arguments.commit)
    print(row)
    if arguments.record:
        record(row)
    if not tally.tried:
        print("nothing was tried")
    return 0 if tally.tried and not tally.failures else 1


if __name__ == "__main__":
    sys.exit(main())
