#!/usr/bin/env python3
"""Checks the ground truth of sequences; exit code 1 when anything is wrong."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from tractrix_dataset.validate import check


def main() -> None:
    """Checks every folder given, or every sequence inside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", help="sequences, or folders of sequences")
    parser.add_argument("--json", type=Path, help="also write all figures to this file")
    arguments = parser.parse_args()
    sequences = [
        s
        for f in arguments.folders
        for s in ([f] if (f / "scene.json").is_file() else sorted(p.parent for p in f.glob("*/scene.json")))
    ]
    if not sequences:
        sys.exit("no scene.json in any of the folders")
    reports = [check(folder) for folder in sequences]
    for report in reports:
        figures = ", ".join(f"{name} {value:.3f}" for name, value in report.figures.items())
        print(f"{report.name}: {'good' if not report.faults else 'WRONG'}: {figures}")
        for fault in report.faults:
            print(f"    {fault}")
    if arguments.json:
        arguments.json.write_text(json.dumps([vars(r) for r in reports], indent=1) + "\n")
    sys.exit(any(r.faults for r in reports))


if __name__ == "__main__":
    main()
