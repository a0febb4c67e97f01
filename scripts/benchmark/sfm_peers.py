#!/usr/bin/env python3
"""Structure from motion on photographs with known camera positions: tractrix and COLMAP, in turns, in one table.

    scripts/benchmark/sfm_peers.py SET... [--tractrix target/release/tractrix] [--only tractrix|colmap] [--repeat N]

A SET is a folder with images/ and meta.json: per image the camera's centre in metres ("gt": {name: {"C": [x, y, z]}}),
or its GPS position ("gps": {name: [latitude, longitude, altitude]}); "K_full" and "scale" give the intrinsics
(K_full / scale, centre of the first pixel at (0.5, 0.5)) where they are known.

Needs numpy and pycolmap (pip install numpy pycolmap). Case A: nothing is said of the camera. Case B: the true
intrinsics, held. "pp" is COLMAP's result after one more bundle adjustment with the principal point free. RMSE is that
of the camera centres after the best similarity; CPU is user and system time of the whole process, reading the images
included.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

Meta = dict[str, Any]
Figures = dict[str, Any]


def positions(meta: Meta) -> dict[str, np.ndarray]:
    """Camera centres by lower-case file name, metres."""
    if meta.get("gt"):
        return {name.lower(): np.array(entry["C"]) for name, entry in meta["gt"].items()}
    names = sorted(meta["gps"])
    earth = np.array([earth_from_gps(*meta["gps"][name]) for name in names])
    lat, lon = np.radians(meta["gps"][names[0]][:2])
    east = [-np.sin(lon), np.cos(lon), 0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    local = (earth - earth[0]) @ np.array([east, north, up]).T
    return {name.lower(): center for name, center in zip(names, local)}


def earth_from_gps(latitude: float, longitude: float, altitude: float) -> list[float]:
    """Earth-centred coordinates on the WGS 84 ellipsoid."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    lat, lon = np.radians([latitude, longitude])
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return [
        (n + altitude) * np.cos(lat) * np.cos(lon),
        (n + altitude) * np.cos(lat) * np.sin(lon),
        (n * (1 - e2) + altitude) * np.sin(lat),
    ]


def rmse(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Root mean square and largest distance after the best similarity (Umeyama 1991)."""
    mean_f, mean_t = found.mean(0), truth.mean(0)
    f, t = found - mean_f, truth - mean_t
    u, s, vt = np.linalg.svd(t.T @ f / len(f))
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ d @ vt
    scale = np.trace(np.diag(s) @ d) / (f**2).sum(1).mean()
    error = np.linalg.norm(scale * f @ rotation.T - t, axis=1)
    return np.sqrt((error**2).mean()), error.max()


def judged(model: Path, truth: dict[str, np.ndarray]) -> Figures:
    """Registered images, RMSE and largest error of a COLMAP model."""
    import pycolmap

    reconstruction = pycolmap.Reconstruction(str(model))
    pairs = [
        (image.projection_center(), truth[image.name.lower()])
        for image in reconstruction.images.values()
        if image.has_pose and image.name.lower() in truth
    ]
    camera = next(iter(reconstruction.cameras.values()))
    figures = {
        "registered": len(pairs),
        "points": len(reconstruction.points3D),
        "camera": list(map(float, camera.params)),
    }
    if len(pairs) >= 3:
        found, true = map(np.array, zip(*pairs))
        figures["rmse_m"], figures["worst_m"] = rmse(found, true)
    return figures


def measured(command: list[str | Path], log: Path) -> Figures:
    """CPU seconds, wall seconds and peak memory (MiB) of a command."""
    start = time.monotonic()
    with open(log, "wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{command[0]} failed; see {log}:\n{Path(log).read_text(errors='replace')[-2000:]}")
    return {
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "wall_s": time.monotonic() - start,
        "peak_mib": usage.ru_maxrss / 1024,
    }


def intrinsics(meta: Meta) -> list[float] | None:
    """fx, fy, cx, cy in pixels, where they are known."""
    if not isinstance(meta.get("K_full"), list):
        return None
    k, scale = meta["K_full"], meta["scale"]
    return [k[0][0] / scale, k[1][1] / scale, k[0][2] / scale, k[1][2] / scale]


def cpu_s() -> float:
    """CPU seconds of this process so far."""
    return sum(resource.getrusage(resource.RUSAGE_SELF)[:2])


def run_colmap(images: Path, work: Path, given: list[float] | None, threads: int = -1) -> None:
    """The measured part: features, exhaustive matching, incremental mapping; default options but for threads."""
    import pycolmap

    database, model = work / "database.db", work / "model"
    marks = [cpu_s()]
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE" if given else "SIMPLE_RADIAL"
    if given:
        reader.camera_params = ",".join(map(str, given))
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.num_threads = matching.num_threads = threads
    pycolmap.extract_features(
        database,
        images,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
    )
    marks.append(cpu_s())
    pycolmap.match_exhaustive(database, matching_options=matching)
    marks.append(cpu_s())
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = threads
    if given:
        options.ba_refine_focal_length = options.ba_refine_extra_params = options.ba_refine_principal_point = False
    model.mkdir()
    found = pycolmap.incremental_mapping(database, images, model, options)
    best = max(found.values(), key=lambda r: r.num_reg_images())
    marks.append(cpu_s())
    (work / "best").mkdir()
    best.write_text(str(work / "best"))
    if not given:
        adjustment = pycolmap.BundleAdjustmentOptions()
        adjustment.refine_principal_point = True
        pycolmap.bundle_adjustment(best, adjustment)
        (work / "pp").mkdir()
        best.write_text(str(work / "pp"))
    stages = dict(zip(["features", "matching", "mapping"], np.diff(marks)))
    (work / "stages.json").write_text(json.dumps(stages | {"pp": cpu_s() - marks[-1]}))


def rows_of(folder: Path, case: str, arguments: argparse.Namespace, work: Path) -> Iterator[tuple[str, Figures]]:
    """Each program's name and figures."""
    meta = json.loads((folder / "meta.json").read_text())
    truth, given = positions(meta), intrinsics(meta) if case == "B" else None
    images = folder / "images"
    if arguments.only != "colmap":
        output = work / "tractrix"
        command = [arguments.tractrix, "sfm", images, "--output", output, "--quiet"]
        if given:
            command += ["--intrinsics", ",".join(map(str, given))]
        cost = measured(command, work / "tractrix.log")
        document = json.loads((output / "run.json").read_text())
        stages = {name: stage["cpu_s"] for name, stage in document["stages"].items()}
        yield "tractrix", cost | {"stages": stages} | judged(output / "background", truth)
    if arguments.only != "tractrix":
        colmap = work / "colmap"
        colmap.mkdir()
        command = [sys.executable, __file__, "--colmap", images, colmap] + ([json.dumps(given)] if given else [])
        cost = measured(command, work / "colmap.log")
        stages = json.loads((colmap / "stages.json").read_text())
        last = stages.pop("pp")
        yield "COLMAP", cost | {"cpu_s": cost["cpu_s"] - last, "stages": stages} | judged(colmap / "best", truth)
        if not given:
            yield "COLMAP + pp", cost | {"stages": stages} | judged(colmap / "pp", truth)


def main() -> None:
    if sys.argv[1:2] == ["--colmap"]:
        images, work, *given = sys.argv[2:]
        run_colmap(Path(images), Path(work), json.loads(given[0]) if given else None)
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+", type=Path, metavar="SET")
    parser.add_argument("--tractrix", default="target/release/tractrix")
    parser.add_argument("--only", choices=["tractrix", "colmap"])
    parser.add_argument("--repeat", type=int, default=1, help="runs of each; the best CPU time counts")
    parser.add_argument("--json", action="store_true", help="print every figure")
    arguments = parser.parse_args()
    parts = "features / matching / mapping"
    print(f"| set | case | program | images | RMSE mm | worst mm | CPU s | of it {parts} | peak MiB |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |", flush=True)
    for folder in arguments.sets:
        meta = json.loads((folder / "meta.json").read_text())
        for case in "AB" if intrinsics(meta) else "A":
            best: dict[str, Figures] = {}
            for _ in range(arguments.repeat):
                with tempfile.TemporaryDirectory() as work:
                    for program, row in rows_of(folder, case, arguments, Path(work)):
                        if program not in best or row["cpu_s"] < best[program]["cpu_s"]:
                            best[program] = row
            for program, row in best.items():
                stages = " / ".join(f"{s:.1f}" for s in row["stages"].values())
                error = f"{row['rmse_m'] * 1000:.2f} | {row['worst_m'] * 1000:.2f}" if "rmse_m" in row else "– | –"
                print(
                    f"| {folder.name} | {case} | {program} | {row['registered']} of {len(positions(meta))} | {error} |"
                    f" {row['cpu_s']:.1f} | {stages} | {row['peak_mib']:.0f} |",
                    flush=True,
                )
                if arguments.json:
                    print(json.dumps(row), file=sys.stderr)


if __name__ == "__main__":
    main()
