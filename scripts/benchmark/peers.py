#!/usr/bin/env python3
"""Structure from motion on photographs by tractrix, COLMAP, Theia and OpenMVG-rs, and `tractrix compare`.

    scripts/benchmark/peers.py IMAGES --output DIR [--intrinsics fx,fy,cx,cy] [--threads N] [--truth TRUTH]
                               [--also NAME=MODEL]... [--tractrix target/release/tractrix]

IMAGES is a folder of photographs, or a SET of sfm_peers.py (images/ and meta.json): then intrinsics and true camera
centers come from it, and a table of errors and costs is printed.

Programs are skipped whose Python packages are missing: pip install numpy pycolmap pytheia openmvg-rs. All run alone, in
processes of their own, with default options (COLMAP: exhaustive matching, one camera; OpenMVG-rs: incremental), and
are measured from outside: CPU seconds, wall seconds and largest resident memory, as the kernel counts them for the
process. Theia starts from COLMAP's features and matches, and its cost is without these; it has one thread. Results of
other programs, in any format that is read, take part with --also; cost.json next to them states their cost.

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
from typing import Any

from sfm_peers import intrinsics, judged, measured, positions, run_colmap

MODELS = {"tractrix": "out", "colmap": "best", "theia": "model", "openmvg-rs": "model/sparse/0"}
MODULES = {"colmap": ["pycolmap"], "theia": ["pycolmap", "pytheia"], "openmvg-rs": ["openmvg_rs"]}


def command_of(name: str, arguments: argparse.Namespace, work: Path) -> list[str]:
    """The command that is measured."""
    if name == "tractrix":
        given = ["--intrinsics", arguments.intrinsics, "--fixed"] if arguments.intrinsics else []
        given += ["--threads", str(arguments.threads)] if arguments.threads > 0 else []
        return [arguments.tractrix, "sfm", str(arguments.images), "--output", str(work / "out"), "--quiet", *given]
    if name == "theia":
        script, database = Path(__file__).with_name("theia_model.py"), arguments.output / "colmap" / "database.db"
        return [sys.executable, str(script), str(database), str(work / "model"), arguments.intrinsics or ""]
    own = [str(arguments.images), str(work), arguments.intrinsics or "", str(arguments.threads)]
    return [sys.executable, __file__, f"--{name}", *own]


def run_openmvg(images: Path, work: Path, given: list[float] | None, threads: int) -> None:
    """The measured part: features, matching, incremental mapping; default options but for threads."""
    import openmvg_rs

    matrix = None
    if given:
        # Its pixels have their centers at whole numbers.
        fx, fy, cx, cy = given
        matrix = work / "K.txt"
        matrix.write_text(f"{fx} 0 {cx - 0.5}\n0 {fy} {cy - 0.5}\n0 0 1\n")
    workers = threads if threads > 0 else None
    scene = openmvg_rs.reconstruct(images, intrinsics=matrix, progress=False, max_workers=workers)
    scene.write_colmap(work / "model")


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


def table(models: dict[str, str], arguments: argparse.Namespace, truth: dict[str, Any]) -> None:
    """Prints errors against the true camera centers, and costs."""
    print("| program | images | RMSE mm | max mm | CPU s | peak MiB |\n| --- | --- | --- | --- | --- | --- |")
    for name, model in models.items():
        place = Path(model)
        found = judged(place / "background" if (place / "background").is_dir() else place, truth)
        cost = json.loads((arguments.output / name / "cost.json").read_text())
        error = f"{found['rmse_m'] * 1000:.2f} | {found['worst_m'] * 1000:.2f}" if "rmse_m" in found else "– | –"
        registered = f"{found['registered']} of {len(truth)}"
        print(f"| {name} | {registered} | {error} | {cost['cpu_s']:.1f} | {cost['peak_rss_mib']:.0f} |", flush=True)


def main() -> None:
    """Runs every program, then compares the results."""
    if sys.argv[1:2] in (["--colmap"], ["--openmvg-rs"]):
        # This process is the one that is measured.
        _, name, images, work, given, threads = sys.argv
        run_peer = run_colmap if name == "--colmap" else run_openmvg
        return run_peer(Path(images), Path(work), [float(v) for v in given.split(",")] if given else None, int(threads))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path, metavar="IMAGES")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--intrinsics", metavar="fx,fy,cx,cy")
    parser.add_argument("--threads", type=int, default=-1, help="threads of each program [default: its own]")
    parser.add_argument("--truth", metavar="TRUTH")
    parser.add_argument("--tractrix", default="target/release/tractrix")
    parser.add_argument("--also", action="append", default=[], metavar="NAME=MODEL", help="what another program made")
    arguments = parser.parse_args()
    truth = None
    if (arguments.images / "meta.json").is_file():
        meta = json.loads((arguments.images / "meta.json").read_text())
        truth, known = positions(meta), intrinsics(meta)
        arguments.images /= "images"
        if known and not arguments.intrinsics:
            arguments.intrinsics = ",".join(map(str, known))
    models = {name: str(model) for name in MODELS if (model := run(name, arguments))}
    if truth and importlib.util.find_spec("pycolmap"):
        table(models, arguments, truth)
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
