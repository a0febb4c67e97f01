#!/usr/bin/env python3
"""Structure from motion on a folder of photographs by tractrix, COLMAP and Theia, and `tractrix compare`.

    scripts/benchmark/peers.py IMAGES --output DIR [--intrinsics fx,fy,cx,cy] [--truth TRUTH] [--also NAME=MODEL]...
                               [--tractrix target/release/tractrix]

COLMAP is taken from pycolmap (pip install numpy pycolmap); without it, it is left out. All run alone, in processes of
their own, with default options (COLMAP: exhaustive matching, one camera), and are measured from outside: CPU seconds,
wall seconds and largest resident memory, as the kernel counts them for the process. Theia (pip install pytheia) starts
from COLMAP's features and matches, and what it costs is without these. Results of OpenMVG and others, in any format
that is read, take part with --also; a cost.json beside them says what they cost.

DIR/NAME/ holds each result with its cost.json, DIR/NAME.log what it said, DIR/compare.html and DIR/compare.json the
comparison. A result that is there is not computed again.
"""

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

from sfm_peers import measured, run_colmap

MODELS = {"tractrix": "out", "colmap": "best", "theia": "model"}
MODULES = {"colmap": ["pycolmap"], "theia": ["pycolmap", "pytheia"]}


def command_of(name: str, arguments: argparse.Namespace, work: Path) -> list[str]:
    """The command that is measured."""
    if name == "tractrix":
        given = ["--intrinsics", arguments.intrinsics] if arguments.intrinsics else []
        return [arguments.tractrix, "sfm", str(arguments.images), "--output", str(work / "out"), "--quiet", *given]
    if name == "theia":
        script, database = Path(__file__).with_name("theia_model.py"), arguments.output / "colmap" / "database.db"
        return [sys.executable, str(script), str(database), str(work / "model"), arguments.intrinsics or ""]
    return [sys.executable, __file__, "--colmap", str(arguments.images), str(work), arguments.intrinsics or ""]


def run(name: str, arguments: argparse.Namespace) -> Path | None:
    """The model that a program made, or None where there is none."""
    work = arguments.output / name
    model = work / MODELS[name]
    if (work / "cost.json").is_file():
        return model
    missing = [module for module in MODULES.get(name, []) if importlib.util.find_spec(module) is None]
    if missing:
        print(f"{name}: left out, since {' and '.join(missing)} is not installed", file=sys.stderr)
        return None
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    print(f"{name}: runs", file=sys.stderr)
    try:
        cost = measured(command_of(name, arguments, work), arguments.output / f"{name}.log")
    except SystemExit as failed:
        print(f"{name}: left out: {failed}", file=sys.stderr)
        return None
    cost["peak_rss_mib"] = cost.pop("peak_mib")
    (work / "cost.json").write_text(json.dumps(cost))
    return model


def main() -> None:
    """Runs every program, then holds the results against one another."""
    if sys.argv[1:2] == ["--colmap"]:
        # This process is the one that is measured.
        _, _, images, work, given = sys.argv
        return run_colmap(Path(images), Path(work), [float(v) for v in given.split(",")] if given else None)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path, metavar="IMAGES")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--intrinsics", metavar="fx,fy,cx,cy")
    parser.add_argument("--truth", metavar="TRUTH")
    parser.add_argument("--tractrix", default="target/release/tractrix")
    parser.add_argument("--also", action="append", default=[], metavar="NAME=MODEL", help="what another program made")
    arguments = parser.parse_args()
    models = {name: str(model) for name in MODELS if (model := run(name, arguments))}
    models |= dict(also.split("=", 1) for also in arguments.also)
    if not models:
        sys.exit("no program made a model")
    command = [arguments.tractrix, "compare", *models.values()]
    command += [part for name in models for part in ("--label", name)]
    command += ["--truth", arguments.truth] if arguments.truth else []
    with open(arguments.output / "compare.json", "w", encoding="utf-8") as out:
        subprocess.run([*command, "--json"], stdout=out, check=False)
    page = ["--page", str(arguments.output / "compare.html"), "--overwrite"]
    sys.exit(subprocess.run([*command, *page], check=False).returncode)


if __name__ == "__main__":
    main()
