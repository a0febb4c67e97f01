#!/usr/bin/env python3
"""All scale estimators on known motions of cameras and vehicles with simulated observations, in one table per set.

    scripts/benchmark/motions.py DATA

DATA has sequences/*/scene.json (rendered), real/vehicle_motions/label_02 (labels of the KITTI tracking benchmark) and
real/vehicle_motions/poses (camera paths); a set that is missing is skipped with a message. The simulation is
examples/scale_estimators.rs, which cargo builds.
"""

import argparse
import subprocess
import sys
from pathlib import Path

EXAMPLE = ["cargo", "run", "--quiet", "--release", "--example", "scale_estimators", "--"]


def sets(data: Path) -> dict[str, list[Path]]:
    """Arguments of the example for each set of motions."""
    motions = data / "real" / "vehicle_motions"
    labels = [motions / "label_02", motions / "poses"]
    return {
        "Rendered sequences": sorted((data / "sequences").glob("**/scene.json")),
        "Vehicles from a moving car": labels if all(path.is_dir() for path in labels) else [],
    }


def main() -> int:
    """Prints the tables; 1 if there are none."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("data", type=Path)
    found = sets(parser.parse_args().data)
    for title, paths in found.items():
        if not paths:
            print(f"{title}: skipped, no data", file=sys.stderr)
            continue
        print(f"\n**{title}**\n", flush=True)
        subprocess.run([*EXAMPLE, *map(str, paths)], check=True)
    return 0 if any(found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
