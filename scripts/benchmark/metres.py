#!/usr/bin/env python3
"""How well metres are found from simulated logs of a receiver, and from a known height of the camera, in one table.

    scripts/benchmark/metres.py OUTPUTS SEQUENCE... [--tractrix target/release/tractrix] [--repeat N]

A SEQUENCE is a folder with scene.json, video.mp4 and masks/; OUTPUTS/<its name> is what `tractrix run` made of it with
`--masks` and `--intrinsics`. The outputs are copied; only the stages `scale` and `metric` run. The receiver's logs
have 1.5 m of noise beside a bias of 3 m that wanders (120 s) along each axis, at 1 Hz and 10 Hz: subtitles of the
video, whose heights are by air pressure and off by a metre; a table and GPX, 0.7 s late, which has to be found. The
truth is the similarity from the camera's centres to those of scene.json.

Needs numpy. Figures of a row: mean and root mean square error of metres per unit, mean stated deviation, share of the
runs within one and two of them, root mean square error of the offset, and how many logs were refused.
"""

import argparse
import itertools
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

Scene = dict[str, Any]
# Errors of metres per unit and stated deviations, as shares, and errors of the offset in seconds.
Figures = list[tuple[float, float, float | None]]

OFFSET_S, NOISE_M, WANDER_M, WANDER_S, BAROMETER_M = 0.7, 1.5, 3.0, 120.0, 1.0
START = datetime(2024, 5, 4, 10, 0, 0, tzinfo=UTC)
LONGITUDE, LATITUDE, HEIGHT_M = 8.55, 47.38, 440.0
METRES_PER_DEGREE = 111_320.0
# What the vehicles of one place have in common, as docs/maths/metric.md has it.
SHARED = 0.035


def centers(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Times in seconds and camera centres in metres."""
    poses = np.array([frame["T_world_camera"] for frame in scene["frames"]]).reshape(-1, 4, 4)
    return np.arange(len(poses)) / scene["fps"], poses[:, :3, 3]


def simulated(
    scene: Scene, rate_hz: float, offset_s: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times on the log's clock, positions of the receiver, and heights by air pressure, in the time of the video."""
    times, path = centers(scene)
    at = np.arange(0.0, times[-1], 1.0 / rate_hz) + rng.uniform(0, 1.0 / rate_hz)
    at = at[at <= times[-1]]
    true = np.stack([np.interp(at, times, path[:, k]) for k in range(3)], axis=1)
    keep = np.exp(-1.0 / rate_hz / WANDER_S)
    bias = np.zeros_like(true)
    bias[0] = WANDER_M * rng.standard_normal(3)
    for i in range(1, len(at)):
        bias[i] = keep * bias[i - 1] + WANDER_M * np.sqrt(1 - keep**2) * rng.standard_normal(3)
    barometric = true[:, 2] + BAROMETER_M * rng.standard_normal() + 0.1 * rng.standard_normal(len(at))
    return at + offset_s, true + bias + NOISE_M * rng.standard_normal(true.shape), barometric


def geodetic(point: np.ndarray) -> tuple[float, float, float]:
    """Longitude, latitude and height; a sphere is good enough for a hundred metres."""
    longitude = LONGITUDE + point[0] / (METRES_PER_DEGREE * np.cos(np.radians(LATITUDE)))
    return longitude, LATITUDE + point[1] / METRES_PER_DEGREE, HEIGHT_M + point[2]


def write_gpx(path: Path, times: np.ndarray, points: np.ndarray, _barometric: np.ndarray) -> None:
    """One track."""
    rows = []
    for time, point in zip(times, points):
        longitude, latitude, height = geodetic(point)
        stamp = (START + timedelta(seconds=time)).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
        rows.append(
            f'<trkpt lat="{latitude:.8f}" lon="{longitude:.8f}"><ele>{height:.2f}</ele><time>{stamp}</time></trkpt>'
        )
    path.write_text('<gpx version="1.1"><trk><trkseg>' + "\n".join(rows) + "</trkseg></trk></gpx>\n")


def write_csv(path: Path, times: np.ndarray, points: np.ndarray, _barometric: np.ndarray) -> None:
    """A table with times of the video."""
    rows = ["time,longitude,latitude,gps_height"]
    rows += [f"{t:.3f},{g[0]:.8f},{g[1]:.8f},{g[2]:.2f}" for t, g in ((t, geodetic(p)) for t, p in zip(times, points))]
    path.write_text("\n".join(rows) + "\n")


def write_srt(path: Path, times: np.ndarray, points: np.ndarray, barometric: np.ndarray) -> None:
    """DJI's subtitles."""

    def stamp(time: float) -> str:
        return f"{int(time // 3600):02}:{int(time // 60) % 60:02}:{int(time) % 60:02},{int(1000 * time) % 1000:03}"

    blocks = []
    for i, (time, point, above) in enumerate(zip(times, points, barometric), 1):
        longitude, latitude, height = geodetic(point)
        said = f"[latitude: {latitude:.8f}] [longitude: {longitude:.8f}] [rel_alt: {above:.3f} abs_alt: {height:.3f}]"
        blocks.append(f"{i}\n{stamp(time)} --> {stamp(time + 0.1)}\n{said}\n")
    path.write_text("\n".join(blocks))


def true_scale(output: Path, scene: Scene) -> float:
    """Metres per unit of the background: Umeyama on the camera centres."""
    _, path = centers(scene)
    by_frame = {frame.get("video_frame", i): path[i] for i, frame in enumerate(scene["frames"])}
    found = read_centers(output / "background")
    names = [name for name in sorted(found) if int(Path(name).stem) in by_frame]
    a = np.array([found[name] for name in names])
    b = np.array([by_frame[int(Path(name).stem)] for name in names])
    a0, b0 = a - a.mean(0), b - b.mean(0)
    u, d, vt = np.linalg.svd(b0.T @ a0 / len(a))
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return float((d * sign).sum() / (a0**2).sum(1).mean())


def read_centers(model: Path) -> dict[str, np.ndarray]:
    """Camera centres of a COLMAP text model by image name."""
    lines = [line for line in (model / "images.txt").read_text().splitlines() if not line.startswith("#")]
    found = {}
    for line in lines[::2]:
        fields = line.split()
        w, x, y, z = map(float, fields[1:5])
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        found[fields[9]] = -rotation.T @ np.array(list(map(float, fields[5:8])))
    return found


def mean_height(sequence: Path, scene: Scene) -> float:
    """Mean height of the camera over the ground below it, metres; over the deck of a bridge."""
    if scene.get("terrain") == "bridge":
        below = np.array([frame["T_world_object"] for frame in scene["frames"]]).reshape(-1, 4, 4)[:, 2, 3]
        return float(np.mean(centers(scene)[1][:, 2] - below))
    vertices = read_ply(sequence / "ground_mesh.ply")
    _, path = centers(scene)
    near = [np.argsort(((vertices[:, :2] - c[:2]) ** 2).sum(1))[:4] for c in path]
    return float(np.mean([c[2] - vertices[index, 2].mean() for c, index in zip(path, near)]))


def read_ply(path: Path) -> np.ndarray:
    """Vertices of a PLY file, text or binary little endian, whose first properties are x, y, z."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode()
    count = next(int(line.split()[2]) for line in header.splitlines() if line.startswith("element vertex"))
    of_vertex = header.split("element vertex")[1].split("element")[0]
    kinds = [line.split()[1] for line in of_vertex.splitlines() if line.startswith("property")]
    if "ascii" in header:
        rows = data[end:].decode().splitlines()[:count]
        return np.array([list(map(float, row.split()[:3])) for row in rows])
    names = {"float": "<f4", "double": "<f8", "uchar": "u1", "float32": "<f4", "float64": "<f8", "int": "<i4"}
    dtype = np.dtype([(str(i), names[kind]) for i, kind in enumerate(kinds)])
    rows = np.frombuffer(data[end:], dtype, count)
    return np.stack([rows[str(i)].astype(float) for i in range(3)], axis=1)


def call_cars(output: Path) -> None:
    """Gives the target the class that a detector would; given masks have none."""
    tracks = json.loads((output / "tracks.json").read_text())
    for tracked in tracks["objects"]:
        tracked["class"] = "car" if tracked["id"] == 1 else tracked["class"]
    (output / "tracks.json").write_text(json.dumps(tracks))
    (output / ".tractrix" / "scale.json").unlink(missing_ok=True)


def metric(tractrix: str, sequence: Path, scene: Scene, output: Path, *flags: str) -> dict[str, Any]:
    """Runs the stage; gives `metric` of trajectories.json."""
    k = scene["K"]
    intrinsics = f"{k[0][0]},{k[1][1]},{k[0][2]},{k[1][2]}"
    command = [tractrix, "metric", str(sequence / "video.mp4"), "--output", str(output), "--masks"]
    command += [str(sequence / "masks"), "--intrinsics", intrinsics, "--quiet", "--threads", "1", *flags]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: {done.stderr}")
    return json.loads((output / "trajectories.json").read_text())["metric"]


def share_of(found: dict[str, Any], name: str) -> tuple[float, float] | None:
    """Metres per unit and their deviation by one source, of which nothing else knows."""
    return next(((s["scale"], s["std"]) for s in found["shares"] if name in s["source"]), None)


def row(name: str, figures: Figures, num_refused: int) -> str:
    """A row of the table."""
    errors = np.array([f[0] for f in figures])
    stds = np.array([f[1] for f in figures])
    offsets = np.array([f[2] for f in figures if f[2] is not None])
    if not len(errors):
        return f"| {name} | – | – | – | – | {num_refused} |"
    within = [np.mean(np.abs(errors) <= k * stds) for k in (1, 2)]
    offset = f"{np.sqrt((offsets**2).mean()):.2f} s" if len(offsets) else "–"
    return (
        f"| {name} | {100 * errors.mean():+.1f} %, {100 * np.sqrt((errors**2).mean()):.1f} % "
        f"| {100 * stds.mean():.1f} % "
        f"| {100 * within[0]:.0f} %, {100 * within[1]:.0f} % | {offset} | {num_refused} |"
    )


def triples(sizes: Figures, names: list[str]) -> Figures:
    """What three different vehicles say together: the mean, as good as three that are equally sure can be."""
    chosen = [c for c in itertools.combinations(range(len(sizes)), 3) if len({names[i] for i in c}) == 3]
    mean = [(np.mean([sizes[i][0] for i in c]), np.mean([sizes[i][1] for i in c])) for c in chosen]
    # What a place has in common stays, the rest averages out.
    return [
        (float(error), float(np.hypot(SHARED, np.sqrt(max(std**2 - SHARED**2, 0) / 3))), None) for error, std in mean
    ]


KINDS = [
    ("SRT, 1 Hz", "srt", 1.0, 0.0),
    ("SRT, 10 Hz", "srt", 10.0, 0.0),
    ("CSV, 10 Hz, 0.7 s late", "csv", 10.0, OFFSET_S),
    ("GPX, 1 Hz, clock unknown", "gpx", 1.0, OFFSET_S),
    ("GPX, 10 Hz, clock unknown", "gpx", 10.0, OFFSET_S),
]
WRITERS = {"srt": write_srt, "csv": write_csv, "gpx": write_gpx}


def logs(
    args: argparse.Namespace, sequence: Path, scene: Scene, output: Path, truth: float, folder: Path
) -> Iterator[tuple[str, Figures, int]]:
    """Figures of every kind of log."""
    for kind, (name, form, rate_hz, offset_s) in enumerate(KINDS):
        figures, refused = [], 0
        for seed in range(args.repeat):
            rng = np.random.default_rng([seed, kind])
            log = simulated(scene, rate_hz, offset_s, rng)
            path = folder / f"log.{form}"
            WRITERS[form](path, *log)
            found = metric(args.tractrix, sequence, scene, output, "--telemetry", str(path))
            share = share_of(found, "telemetry")
            if share is None:
                refused += 1
                continue
            # A clock counts from 1970; of one that is unknown the log says when the video began.
            began = START.timestamp() if form == "gpx" else 0.0
            offset_error = found["time_offset_s"] - began - offset_s
            figures.append((share[0] / truth - 1, share[1] / share[0], offset_error))
        yield name, figures, refused


def main() -> None:
    """Reads the arguments, and prints rows as they come and the table at the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outputs", type=Path)
    parser.add_argument("sequences", type=Path, nargs="+")
    parser.add_argument("--tractrix", default="target/release/tractrix")
    parser.add_argument("--repeat", type=int, default=10)
    args = parser.parse_args()
    by_kind, heights, sizes, names = {}, [], [], {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for sequence in args.sequences:
            scene = json.loads((sequence / "scene.json").read_text())
            output = folder / sequence.name
            shutil.copytree(args.outputs / sequence.name, output)
            call_cars(output)
            truth = true_scale(output, scene)
            # A sequence without the mesh of its ground has no true height.
            has_ground = (sequence / "ground_mesh.ply").is_file()
            flags = ["--camera-height", f"{mean_height(sequence, scene)}±0.001"] if has_ground else []
            found = metric(args.tractrix, sequence, scene, output, "--no-telemetry", *flags)
            for name, figures in (("camera height", heights), ("vehicles", sizes)):
                share = share_of(found, name)
                if share:
                    names.setdefault(name, []).append(scene["vehicle"])
                    figures.append((share[0] / truth - 1, share[1] / share[0], None))
                    print(
                        f"{sequence.name}: {name} {100 * figures[-1][0]:+.1f} ± {100 * figures[-1][1]:.1f} %",
                        flush=True,
                    )
            for name, figures, refused in logs(args, sequence, scene, output, truth, folder):
                print(f"{sequence.name}: {row(name, figures, refused)}", flush=True)
                before = by_kind.setdefault(name, ([], 0))
                by_kind[name] = (before[0] + figures, before[1] + refused)
            shutil.rmtree(output)
    print("\n| Source | Error: mean, rms | Stated | Within 1, 2 | Offset: rms | Refused |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, (figures, refused) in by_kind.items():
        print(row(name, figures, refused))
    print(row("camera height", heights, len(args.sequences) - len(heights)))
    print(row("what vehicles are like, three different ones", triples(sizes, names.get("vehicles", [])), 0))
    print(row("what vehicles are like, one vehicle", sizes, len(args.sequences) - len(sizes)))


if __name__ == "__main__":
    main()
