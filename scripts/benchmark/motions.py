#!/usr/bin/env python3
"""All scale estimators on known motions of cameras and vehicles with simulated observations, in one table per set.

    scripts/benchmark/motions.py DATA

Rendered sequences: the bundled one and those of DATA/sequences. Vehicles seen from a car: DATA/real/vehicle_motions has
label_02 (labels of the KITTI tracking benchmark) and poses (camera paths); without them the set is skipped with a
message. The simulation is examples/scale_estimators.rs, which cargo builds.
"""

import argparse
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ["cargo", "run", "--quiet", "--release", "--example", "scale_estimators", "--"]


def sets(data: Path) -> dict[str, list[Path]]:
    """Arguments of the example for each set of motions."""
    motions = data / "real" / "vehicle_motions"
    labels = [motions / "label_02", motions / "poses"]
    return {
        "Rendered sequences": [ROOT / "dataset/demo/scene.json", *sorted((data / "sequences").glob("**/scene.json"))],
        "Vehicles from a moving car": labels if all(path.is_dir() for path in labels) else [],
    }


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("data", type=Path)
    for title, paths in sets(parser.parse_args().data.resolve()).items():
        if not paths:
            print(f"{title}: skipped, no data", file=sys.stderr)
            continue
        print(f"\n**{title}**\n", flush=True)
        subprocess.run([*EXAMPLE, *map(str, paths)], check=True, cwd=ROOT)


if __name__ == "__main__":
    main()
