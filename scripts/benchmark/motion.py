#!/usr/bin/env python3
"""How well the speed, the yaw rate and the size of a vehicle are found, each against what is stated, in two tables.

    scripts/benchmark/motion.py OUTPUTS SEQUENCE... [--tractrix target/release/tractrix] [--as-they-are]

A SEQUENCE is a folder with scene.json, video.mp4, masks/ and object_mesh.ply; OUTPUTS/<its name> is what `tractrix run`
made of it with `--masks` and `--intrinsics`, and so is OUTPUTS/<its name>_<seed> with `--seed`. The outputs are copied
and the stages `scale` and `metric` run with the true metres per unit, so that nothing but the vehicle's own motion is
judged; `--as-they-are` takes outputs that were made so. Vehicle 1 is compared with `T_world_object`.

The truth of a speed is that of the point of the vehicle that the program follows. Extents are compared with the mesh:
width without mirrors (the median over its length), height without aerials; and the point that is followed with the
center of the mesh. Needs numpy.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from metres import read_centers, read_ply, true_scale

Scene = dict[str, Any]
DIMENSIONS = ("length", "width", "height")


class Errors(NamedTuple):
    """What is found, what is true, and the stated deviation, one each a frame."""

    found: np.ndarray
    true: np.ndarray
    std: np.ndarray

    def rms(self) -> float:
        """Root mean square error."""
        return float(np.sqrt(np.mean((self.found - self.true) ** 2)))

    def within(self, deviations: float) -> float:
        """Share within so many deviations."""
        return float(np.mean(np.abs(self.found - self.true) <= deviations * self.std))


class Output(NamedTuple):
    """What is judged in one output."""

    raw_speed: Errors
    speed: Errors
    yaw_rate: Errors | None
    extents: dict[str, tuple[float, float]]
    # The point of the vehicle that is followed, in its own frame, metres; the standard deviation that is stated for the
    # center of the body, None where it is the center of the points.
    followed: np.ndarray
    center_std: float | None


def outputs(folder: Path, sequence: Path) -> Iterator[tuple[Path, int]]:
    """The outputs of a sequence, with their seeds."""
    for path in sorted(folder.glob(f"{sequence.name}*")):
        seed = path.name.removeprefix(sequence.name).removeprefix("_")
        if (path / "trajectories.json").is_file() and (seed.isdigit() or not seed):
            yield path, int(seed or 0)


def in_true_metres(tractrix: str, sequence: Path, scene: Scene, source: Path, seed: int, copy: Path) -> None:
    """Makes a copy of an output whose metres are the true ones."""
    shutil.copytree(source, copy)
    k = scene["K"]
    command = [tractrix, "metric", str(sequence / "video.mp4"), "--output", str(copy)]
    command += ["--masks", str(sequence / "masks"), "--intrinsics", f"{k[0][0]},{k[1][1]},{k[0][2]},{k[1][2]}"]
    command += ["--no-telemetry", "--scale", f"{true_scale(source, scene)}±1e-6", "--seed", str(seed)]
    arguments = json.loads((source / "run.json").read_text())["arguments"]
    command += ["--only-object", "1"] if "--only-object" in arguments else []
    done = subprocess.run([*command, "--threads", "1", "--quiet"], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: {done.stderr}")


def followed_point(
    scene: Scene, output: Path, placed: list[dict[str, Any]], objects: np.ndarray
) -> tuple[np.ndarray, float]:
    """The mean place of the point that the program follows, in the vehicle's own frame, and true metres per unit."""
    centers = read_centers(output / "background")
    names = [f["name"] for f in placed if f["name"] in centers]
    truth = {i: np.array(f["T_world_camera"])[:3, 3] for i, f in by_frame(scene).items()}
    found = np.array([centers[name] for name in names])
    scale, rotation, translation = umeyama(found, np.array([truth[int(Path(name).stem)] for name in names]))
    positions = scale * np.array([f["position"] for f in placed]) @ rotation.T + translation
    arms = [pose[:3, :3].T @ (position - pose[:3, 3]) for pose, position in zip(objects, positions)]
    return np.mean(arms, axis=0), scale


def umeyama(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation and translation of the similarity from a to b."""
    a0, b0 = a - a.mean(0), b - b.mean(0)
    u, d, vt = np.linalg.svd(b0.T @ a0 / len(a))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = float((d * sign).sum() / (a0**2).sum(1).mean())
    return scale, rotation, b.mean(0) - scale * rotation @ a.mean(0)


def by_frame(scene: Scene) -> dict[int, dict[str, Any]]:
    """Frames of the truth by their index in the video."""
    return {frame.get("video_frame", i): frame for i, frame in enumerate(scene["frames"])}


def judge(output: Path, scene: Scene) -> Output | None:
    """Vehicle 1 against its truth; None without its motion."""
    objects = json.loads((output / "trajectories.json").read_text())["objects"]
    entry = next((o for o in objects if o["id"] == 1), {})
    truth = by_frame(scene)
    placed = [f for f in entry.get("frames", []) if f.get("speed_m_s") is not None and f["frame"] in truth]
    if len(placed) < 4:
        return None
    time = np.array([f["time_s"] for f in placed])
    poses = np.array([truth[f["frame"]]["T_world_object"] for f in placed]).reshape(-1, 4, 4)
    forward = poses[:, :3, 0]
    followed, scale = followed_point(scene, output, placed, poses)
    path = poses[:, :3, :3] @ followed + poses[:, :3, 3]
    center = entry.get("body_center")
    center_std = center and scale * entry["scale"]["ratio"] * float(np.sqrt(np.trace(np.array(center["covariance"]))))
    speed = (np.gradient(path, time, axis=0, edge_order=2) * forward).sum(1)
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))

    def errors(name: str, true: np.ndarray) -> Errors:
        std = [f.get(name.replace("yaw_rate", "yaw_rate_std").replace("speed_m", "speed_std_m")) or 0.0 for f in placed]
        return Errors(np.array([f[name] for f in placed], float), true, np.array(std))

    has_yaw = placed[0].get("yaw_rate_deg_s") is not None
    sizes = {name: (entry.get("dimensions") or {}).get(f"{name}_m") for name in DIMENSIONS}
    return Output(
        Errors(np.array([f["raw_speed_m_s"] for f in placed]), speed, np.ones(len(placed))),
        errors("speed_m_s", speed),
        errors("yaw_rate_deg_s", -np.degrees(np.gradient(yaw, time))) if has_yaw else None,
        {name: (size["value"], size["std"]) for name, size in sizes.items() if size},
        followed,
        center_std,
    )


def true_size(sequence: Path) -> tuple[dict[str, float], np.ndarray]:
    """Length, width without mirrors and height without aerials, metres: medians and next to largest of 20 slices.

    And the middle of the body.
    """
    vertices = read_ply(sequence / "object_mesh.ply")
    low, high = vertices.min(0), vertices.max(0)
    slices = np.clip(((vertices[:, 0] - low[0]) / (high[0] - low[0]) * 20).astype(int), 0, 19)
    within = [vertices[slices == i] for i in range(20) if (slices == i).any()]
    half_widths = [np.abs(part[:, 1] - (low[1] + high[1]) / 2).max() for part in within]
    heights = sorted(part[:, 2].max() for part in within)
    size = {"length": high[0] - low[0], "width": 2 * float(np.median(half_widths)), "height": heights[-2]}
    return size, np.array([*(low + high)[:2] / 2, heights[-2] / 2])


def motion_row(name: str, found: list[Output]) -> str:
    """Raw and smoothed speed as shares of the mean speed, and yaw rates; over all seeds."""
    mean_speed = np.mean([np.abs(o.speed.true).mean() for o in found])

    def share(values: list[float]) -> float:
        return 100 * float(np.sqrt(np.mean(np.square(values)))) / mean_speed

    row = f"| {name} | {len(found)} | {share([o.raw_speed.rms() for o in found]):.1f} % "
    row += f"| {share([o.speed.rms() for o in found]):.1f} %, {share([o.speed.std.mean() for o in found]):.1f} % "
    row += f"| {100 * np.mean([o.speed.within(1) for o in found]):.0f} %, "
    row += f"{100 * np.mean([o.speed.within(2) for o in found]):.0f} % "
    yaw = [o.yaw_rate for o in found if o.yaw_rate]
    if not yaw:
        return row + "| – |"
    rms, std = np.mean([y.rms() for y in yaw]), np.mean([y.std.mean() for y in yaw])
    return row + f"| {rms:.1f}, {std:.1f} °/s, {100 * np.mean([y.within(1) for y in yaw]):.0f} % |"


def extents_row(name: str, found: Output, truth: dict[str, float], middle: np.ndarray) -> str:
    """Error and stated deviation of each extent and of the center."""
    cells = []
    for dimension in DIMENSIONS:
        value, std = found.extents.get(dimension, (None, None))
        if value is None:
            cells.append("not seen")
            continue
        cells.append(f"{100 * (value / truth[dimension] - 1):+.1f} % ± {100 * std / value:.1f}")
    off = float(np.linalg.norm(found.followed - middle))
    stated = "points" if found.center_std is None else f"± {found.center_std:.2f}"
    return f"| {name} | " + " | ".join(cells) + f" | {off:.2f} {stated} |"


def main() -> None:
    """Reads the arguments and prints both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outputs", type=Path)
    parser.add_argument("sequences", type=Path, nargs="+")
    parser.add_argument("--tractrix", default="target/release/tractrix")
    parser.add_argument("--as-they-are", action="store_true", help="the outputs have the true metres already")
    args = parser.parse_args()
    motions, extents, coverage = [], [], []
    with tempfile.TemporaryDirectory() as temporary:
        for sequence in args.sequences:
            scene = json.loads((sequence / "scene.json").read_text())
            found = []
            for source, seed in outputs(args.outputs, sequence):
                output = source
                if not args.as_they_are:
                    output = Path(temporary) / source.name
                    in_true_metres(args.tractrix, sequence, scene, source, seed, output)
                found.append(judge(output, scene))
            found = [one for one in found if one]
            if found:
                motions.append(motion_row(sequence.name, found))
                extents.append(extents_row(sequence.name, found[0], *true_size(sequence)))
                coverage.append([np.mean([one.speed.within(k) for one in found]) for k in (1, 2)])
                print(motions[-1], file=sys.stderr, flush=True)
    print("| sequence | seeds | raw speed | smoothed speed, stated | within one, two | yaw rate, stated, within one |")
    print("| --- | --- | --- | --- | --- | --- |", *motions, sep="\n")
    one, two = 100 * np.mean(coverage, axis=0)
    print(f"\nSpeeds within one deviation {one:.0f} %, within two {two:.0f} %, every sequence counting the same.\n")
    print("| sequence | length | width | height | center, m |", "| --- | --- | --- | --- | --- |", *extents, sep="\n")


if __name__ == "__main__":
    main()
