#!/usr/bin/env python3
"""Runs real clips in several ways, compares them with the truth and with one another, and prints the tables.

    scripts/benchmark/real.py DATA OUT [--tractrix target/release/tractrix] [--clip NAME]... [--variant NAME]...

DATA/real has clips with truth: folders with image_l/, calib.txt and poses.txt (the KITTI odometry benchmark's form) and
GoPro videos; DATA/videos has clips without, with truth/NAME.target_2d.txt (boxes of one moving vehicle) and
truth/NAME_intrinsics*.json where known. `parked` in a clip's name: all its vehicles are stationary. Variants that are
done with the same program are not run again (OUT/CLIP/VARIANT.done). Each runs with one thread at low priority.

Needs numpy, Pillow, ffmpeg and ffprobe. Run by `scripts/benchmark/all`, which writes the page.
"""

import argparse
import functools
import json
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import real_truth as truth
from run_output import Box, RunOutput, box_iou, box_of, read_json

# Two tracks whose boxes overlap by so much in the median frame are of one vehicle.
MIN_IOU = 0.5
# Boxes are read from masks of every so many frames.
EVERY = 3
# Quality of `encoded`: about a tenth of the bits of `backward`, whose 12 leaves the images as they are.
CRF = {"encoded": 32, "backward": 12}
STATES = {"standing": "stationary", "moving": "moving", "undetermined": "undetermined"}


@dataclass
class Clip:
    """A clip and what is known of it."""

    name: str
    input: Path
    fps: float | None = None
    intrinsics: list[float] | None = None
    poses: Path | None = None
    target: Path | None = None

    @property
    def is_parked(self) -> bool:
        """All vehicles are stationary."""
        return "parked" in self.name

    @functools.cached_property
    def receiver(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Times and positions of the receiver in the video."""
        return None if self.input.is_dir() else truth.receiver_path(self.input)

    @functools.cached_property
    def num_frames(self) -> int:
        """Frames of the clip."""
        if self.input.is_dir():
            return len(list(self.input.glob("*.png")))
        return int(self.probed("nb_frames"))

    @functools.cached_property
    def rate(self) -> float:
        """Frames per second."""
        if self.fps:
            return self.fps
        over, under = self.probed("avg_frame_rate").split("/")
        return float(over) / float(under)

    def probed(self, entry: str) -> str:
        """A fact of the video stream."""
        command = ["ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries", f"stream={entry}"]
        return subprocess.run(
            [*command, "-of", "csv=p=0", str(self.input)], capture_output=True, text=True, check=True
        ).stdout.strip(",\n")


def find_clips(data: Path) -> list[Clip]:
    """All clips of the data."""
    clips = []
    for poses in sorted(data.glob("real/*/poses.txt")):
        row = [float(x) for x in (poses.parent / "calib.txt").read_text().split()[:12]]
        # KITTI counts from the center of the upper left pixel.
        known = [row[0], row[5], row[2] + 0.5, row[6] + 0.5]
        clips.append(Clip(poses.parent.name, poses.parent / "image_l", 10.0, known, poses))
    for video in sorted([*data.glob("real/*.mp4"), *data.glob("videos/*.mp4")]):
        clip = Clip(video.stem, video)
        target = video.parent / "truth" / f"{video.stem}.target_2d.txt"
        clip.target = target if target.exists() else None
        family = video.stem.split("_")
        known = [p for p in video.parent.glob("truth/*_intrinsics*.json") if set(p.stem.split("_")[:2]) <= set(family)]
        if known:
            found = json.loads(known[0].read_text())
            ((fx, _, cx), (_, fy, cy), _), (k1, k2, p1, p2, k3) = found["K"], found["dist_k1k2p1p2k3"]
            clip.intrinsics = [fx, fy, cx + 0.5, cy + 0.5, k1, k2, p1, p2, k3]
        clips.append(clip)
    return clips


def variants(clip: Clip, out: Path) -> dict[str, list[str]]:
    """Arguments of `tractrix run` for every variant; `whole` is what the others are compared with."""

    def arguments(path: Path, focal: float | None = 1.0, fps: bool = True) -> list[str]:
        given = [str(path), *(["--fps", str(clip.fps)] if clip.fps and fps else [])]
        if clip.intrinsics and focal:
            fx, fy, *rest = clip.intrinsics
            given += ["--intrinsics", ",".join(f"{x:.7g}" for x in [fx * focal, fy * focal, *rest])]
        return given

    whole, half = arguments(clip.input), clip.num_frames // 2
    found = {"whole": whole, "seed 1": [*whole, "--seed", "1"]}
    found |= {"first half": [*whole, "--end", f"{half}f"], "second half": [*whole, "--start", f"{half}f"]}
    found |= {name: arguments(out / f"{name}.mp4", fps=False) for name in CRF}
    if clip.intrinsics:
        found |= {"no intrinsics": arguments(clip.input, None), "focal length +1 %": arguments(clip.input, 1.01)}
    if clip.receiver:
        found["no telemetry"] = [*whole, "--no-telemetry"]
    return found


def encode(clip: Clip, name: str, path: Path) -> None:
    """Encodes a clip again, for `backward` in reverse order."""
    source = ["-framerate", str(clip.fps), "-i", str(clip.input / "%06d.png")] if clip.fps else ["-i", str(clip.input)]
    codec = ["-c:v", "libx264", "-crf", str(CRF[name]), "-pix_fmt", "yuv420p", "-an", "-threads", "1"]
    # The format needs even sizes; a row less at the lower or right border moves no pixel.
    even = "crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0"
    order = ["-vf", f"{even},reverse"] if name == "backward" else ["-vf", even, "-fps_mode", "passthrough"]
    path.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(["ffmpeg", "-v", "error", "-y", *source, *order, *codec, str(path)], check=True)


def run(clip: Clip, variant: str, given: list[str], out: Path, tractrix: str, version: str) -> bool:
    """Runs a variant unless that is done; false if it failed."""
    done, folder = out / f"{variant}.done", out / variant
    if done.exists() and done.read_text() == version:
        return True
    if variant in CRF and not (video := out / f"{variant}.mp4").exists():
        encode(clip, variant, video)
    print(f"== {clip.name}: {variant}", file=sys.stderr, flush=True)
    command = ["nice", "-n", "10", tractrix, "run", *given, "--output", str(folder), "--threads", "1", "--overwrite"]
    with (out / f"{variant}.log").open("w") as log:
        code = subprocess.run(command, stdout=log, stderr=log, check=False).returncode
    if code == 0:
        done.write_text(version)
    return code == 0


class Result:
    """Camera path and vehicles of one run, by index of the frame in the whole clip."""

    def __init__(self, clip: Clip, variant: str, folder: Path) -> None:
        self.output = RunOutput(folder)
        self.trajectories = read_json(folder / "trajectories.json")
        self.metric = (self.trajectories.get("metric") or {}) if self.trajectories else {}
        self.last = clip.num_frames - 1 if variant == "backward" else None
        rows = [row.split() for row in (folder / "background/images.txt").read_text().splitlines() if row[:1] != "#"]
        self.rotations, self.centers = {}, {}
        for row in rows[::2]:
            turn = truth.rotation_of([float(x) for x in row[1:5]])
            self.rotations[self.index(row[9])] = turn
            self.centers[self.index(row[9])] = -turn.T @ np.array([float(x) for x in row[5:8]])

    def index(self, name: str) -> int:
        """Index of a frame in the clip by its name."""
        index = int(name.split(".")[0])
        return index if self.last is None else self.last - index

    @property
    def scale(self) -> float | None:
        """Meters per unit."""
        return self.metric.get("scale")

    @functools.cached_property
    def boxes(self) -> dict[int, dict[int, Box]]:
        """Boxes of every track, by index of the frame; every third."""
        found = {}
        for track in self.output.ids:
            by_index = {self.index(name): name for name in self.output.names(track)}
            masks = ((i, self.output.mask(track, name)) for i, name in by_index.items() if i % EVERY == 0)
            boxes = ((i, box_of(mask)) for i, mask in masks if mask is not None)
            found[track] = {i: box for i, box in boxes if box}
        return found

    @functools.cached_property
    def distances(self) -> dict[int, dict[int, float]]:
        """Distance of every vehicle from the camera, units, by index of the frame."""
        found = {}
        for track, entry in self.output.objects.items():
            poses = [(self.index(pose["name"]), np.array(pose["position"])) for pose in entry["frames"]]
            found[track] = {i: np.linalg.norm(p - self.centers[i]) for i, p in poses if i in self.centers}
        return found

    def verdict(self, track: int) -> str | None:
        """Verdict of a trajectory."""
        return (self.output.objects.get(track, {}).get("verdict") or {}).get("state")

    def state(self, track: int) -> str:
        """Movement of a track."""
        return STATES.get((self.output.tracked.get(track, {}).get("movement") or {}).get("state"), "–")


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def percent(value: float | None, digits: int = 1) -> str:
    """A share in percent with its sign."""
    return "–" if value is None else f"{100 * value:+.{digits}f} %"


def metric_error(result: Result, scale: float) -> str:
    """Error of meters per unit and its stated standard deviation."""
    if not result.scale:
        return "–"
    return f"{percent(result.scale / scale - 1)} (±{100 * result.metric['std']['scale'] / result.scale:.1f} %)"


def true_scale(clip: Clip, result: Result) -> float | None:
    """Meters per unit by known poses."""
    if not clip.poses:
        return None
    centers, frames = truth.read_poses(clip.poses)[1], sorted(result.centers)
    return truth.similarity(np.array([result.centers[i] for i in frames]), centers[frames]).scale


def against_poses(clip: Clip, result: Result) -> list[str]:
    """Camera path against known poses."""
    turns, centers = truth.read_poses(clip.poses)
    frames = sorted(result.centers)
    a, b = np.array([result.centers[i] for i in frames]), centers[frames]
    fit, half = truth.similarity(a, b), len(frames) // 2
    drift = truth.similarity(a[half:], b[half:]).scale / truth.similarity(a[:half], b[:half]).scale - 1
    both = np.array([turns[i] @ result.rotations[i] for i in frames])
    rest = truth.angles_deg(truth.mean_rotation(both).T @ both)
    rms = f"{fit.rms:.3f} m of {truth.length(b):.1f} m"
    turned = f"{np.sqrt((rest**2).mean()):.3f}°"
    return [f"{len(frames)} of {clip.num_frames}", rms, turned, percent(drift), metric_error(result, fit.scale)]


def against_receiver(clip: Clip, result: Result) -> list[str]:
    """Camera path against the receiver, whose delay is fitted, and rotations against the camera's sensors."""
    times, positions = clip.receiver
    frames = sorted(result.centers)
    a = np.array([result.centers[i] for i in frames])

    def fitted(delay_s: float) -> truth.Similarity:
        at = np.array(frames) / clip.rate + delay_s
        inside = (at >= times[0]) & (at <= times[-1])
        b = np.stack([np.interp(at[inside], times, positions[:, k]) for k in range(3)], axis=1)
        return truth.similarity(a[inside], b)

    fit = min((fitted(delay) for delay in np.arange(-1, 1.01, 0.05)), key=lambda fit: fit.rms)
    turned = "–"
    if sensors := truth.sensor_rotations(clip.input):
        near = [int(np.argmin(np.abs(sensors[0] - i / clip.rate))) for i in frames]
        both = np.array([sensors[1][k].T @ result.rotations[i] for k, i in zip(near, frames)])
        rest = truth.angles_deg(truth.mean_rotation(both).T @ both)
        turned = f"{np.sqrt((rest**2).mean()):.2f}°"
        if result.metric.get("rotation_wxyz"):
            down = np.mean([result.rotations[i].T @ sensors[2][k] for k, i in zip(near, frames)], axis=0)
            up = truth.rotation_of(result.metric["rotation_wxyz"]).T @ [0.0, 0.0, 1.0]
            tilt = np.degrees(np.arccos(np.clip(-up @ down / np.linalg.norm(down), -1, 1)))
            turned += f", vertical {tilt:.2f}°"
    rms = f"{fit.rms:.2f} m of {truth.length(a) * fit.scale:.1f} m"
    return [f"{len(frames)} of {clip.num_frames}", rms, turned, "–", metric_error(result, fit.scale)]


def truth_table(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """Camera paths and meters against the truth."""
    rows = []
    for clip in clips:
        judge = against_poses if clip.poses else against_receiver if clip.receiver else None
        if judge:
            rows += [[clip.name, variant, *judge(clip, found)] for variant, found in results[clip.name].items()]
    head = ["Clip", "Variant", "Registered", "Path, RMS", "Rotation, RMS", "Scale drift", "Meters per unit (σ)"]
    return table(head, rows)


def target_row(clip: Clip, result: Result) -> str:
    """Tracks that follow the annotated vehicle, with their state and share of its frames."""
    rows = [np.fromstring(line, sep=",") for line in clip.target.read_text().splitlines()]
    boxes = {i: (x, y, x + w, y + h) for i, (x, y, w, h) in enumerate(rows) if np.isfinite(x)}
    wanted = [i for i in boxes if i % EVERY == 0]
    said = []
    for track, found in result.boxes.items():
        hits = sum(box_iou(found[i], boxes[i]) > MIN_IOU for i in wanted if i in found)
        if hits:
            said.append((hits / len(wanted), f"{track}: {result.state(track)}, {100 * hits / len(wanted):.0f} %"))
    return "; ".join(text for _, text in sorted(said, reverse=True)[:3]) or "none"


def label_table(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """Movement and verdicts of all tracks of the whole clips."""
    rows = []
    for clip in clips:
        for variant, result in results[clip.name].items():
            if variant not in ("whole", "no intrinsics", "no telemetry"):
                continue
            states = Counter(result.state(track) for track in result.output.tracked)
            verdicts = Counter(result.verdict(track) for track in result.output.objects)
            known = "all stationary" if clip.is_parked else "–"
            known = f"annotated vehicle: {target_row(clip, result)}" if clip.target else known
            counts = [str(states[state]) for state in ("stationary", "undetermined", "moving")]
            order = [name for name in ("good", "fair", "doubtful", "rejected") if verdicts[name]]
            shown = ", ".join(f"{verdicts[name]} {name}" for name in order)
            rows.append([clip.name, variant, known, *counts, shown or "none"])
    head = ["Clip", "Variant", "Truth", "Stationary", "Undetermined", "Moving", "Trajectories"]
    return table(head, rows)


def same_vehicles(whole: Result, other: Result) -> list[tuple[int, int]]:
    """Pairs of tracks of one vehicle."""
    pairs = []
    for track, boxes in whole.boxes.items():
        best = (MIN_IOU, None)
        for candidate, others in other.boxes.items():
            common = boxes.keys() & others.keys()
            if len(common) >= 3:
                best = max(best, (float(np.median([box_iou(boxes[i], others[i]) for i in common])), candidate))
        if best[1] is not None:
            pairs.append((track, best[1]))
    return pairs


def repeat_row(whole: Result, other: Result) -> list[str]:
    """A variant against the whole clip."""
    common = sorted(whole.centers.keys() & other.centers.keys())
    if len(common) < 3:
        return [str(len(common)), "–", "–", "–", "–"]
    b = np.array([whole.centers[i] for i in common])
    fit = truth.similarity(np.array([other.centers[i] for i in common]), b)
    meters = other.scale / fit.scale / whole.scale - 1 if whole.scale and other.scale else None
    pairs = same_vehicles(whole, other)
    moved = [(whole.state(one), other.state(same)) for one, same in pairs]
    changed = Counter(f"{was} → {now}" for was, now in moved if was != now)
    labels = f"{len(pairs) - changed.total()} of {len(pairs)}"
    labels += "".join(f"; {count} {change}" for change, count in changed.items())
    ratios = []
    for one, same in pairs:
        if "rejected" in (whole.verdict(one), other.verdict(same)):
            continue
        near, far = whole.distances.get(one, {}), other.distances.get(same, {})
        if shared := near.keys() & far.keys():
            ratios.append(np.median([far[i] * fit.scale / near[i] for i in shared]))
    distances = ", ".join(f"{ratio:.3f}" for ratio in sorted(ratios)) or "–"
    return [str(len(common)), f"{100 * fit.rms / truth.length(b):.2f} %", percent(meters), labels, distances]


def repeat_table(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """All variants against the whole clips."""
    rows = []
    for clip in clips:
        whole = results[clip.name].get("whole")
        if whole:
            others = [(name, found) for name, found in results[clip.name].items() if name != "whole"]
            rows += [[clip.name, name, *repeat_row(whole, found)] for name, found in others]
    head = ["Clip", "Variant", "Frames", "Path, RMS", "Meters per unit", "Same movement", "Distances of vehicles"]
    return table(head, rows)


def size_rows(clip: Clip, result: Result) -> tuple[list[list[str]], list[tuple[str, float]]]:
    """Sizes of the vehicles of a clip with their deviations from their class, and those deviations by kind.

    Meters are those of known poses, otherwise those of the run.
    """
    known, shared = truth.segments()
    rows, deviations = [], []
    metric_std = result.metric["std"]["scale"] / result.scale if result.scale else 0.0
    scale = true_scale(clip, result)
    factor, metric_share = (scale / result.scale, metric_std**2) if scale and result.scale else (1.0, 0.0)
    for track, entry in sorted(result.output.objects.items()):
        sizes = [(entry.get("dimensions") or {}).get(f"{name}_m") for name in ("length", "width", "height")]
        if result.verdict(track) in (None, "rejected") or entry["class"] not in known or not any(sizes):
            continue
        rows_of_class = known[entry["class"]]
        weights, medians, spreads = rows_of_class[:, 0], np.log(rows_of_class[:, 1:4]), rows_of_class[:, 4:7]
        cells = []
        for k, name in enumerate(("length", "width", "height")):
            if not sizes[k]:
                cells.append("–")
                continue
            value = factor * sizes[k]["value"]
            std = value * np.sqrt(max((sizes[k]["std"] / sizes[k]["value"]) ** 2 - metric_share, 0.01**2))
            z = truth.quantile_of(np.log(value), std / value, weights, medians[:, k], spreads[:, k])
            deviations.append((name, z))
            cells.append(f"{value:.2f} ± {std:.2f} m ({z:+.1f})")
        common = ((entry["scale"]["std"] or 0.0) / entry["scale"]["ratio"]) ** 2 + metric_std**2
        for name, a in (("length / width", 0), ("height / width", 2)):
            if not (sizes[a] and sizes[1]):
                cells.append("–")
                continue
            own = [max((sizes[k]["std"] / sizes[k]["value"]) ** 2 - common, 0.01**2) for k in (a, 1)]
            ratio = sizes[a]["value"] / sizes[1]["value"]
            spread = np.sqrt(spreads[:, a] ** 2 + spreads[:, 1] ** 2 - 2 * shared * spreads[:, a] * spreads[:, 1])
            z = truth.quantile_of(np.log(ratio), np.sqrt(sum(own)), weights, medians[:, a] - medians[:, 1], spread)
            deviations.append((name, z))
            cells.append(f"{ratio:.2f} ({z:+.1f})")
        basis = "poses" if scale else result.metric.get("verdict", "–")
        rows.append(
            [clip.name, f"{track}, {entry['class']}", basis, result.state(track), result.verdict(track), *cells]
        )
    return rows, deviations


def size_tables(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """Sizes of all vehicles that are not rejected, and how often they are within their class."""
    rows, all_deviations = [], []
    for clip in clips:
        if "whole" in results[clip.name]:
            found, deviations = size_rows(clip, results[clip.name]["whole"])
            rows += found
            all_deviations += deviations
    counts = []
    for kind in ("length", "width", "height", "length / width", "height / width"):
        z = np.array([value for name, value in all_deviations if name == kind])
        if len(z):
            within = [f"{100 * np.mean(np.abs(z) <= k):.0f} %" for k in (1, 2, 3)]
            counts.append([kind, str(len(z)), f"{np.median(z):+.1f}", *within])
    head = ["Clip", "Vehicle", "Meters", "Movement", "Verdict", "Length", "Width", "Height", "L / W", "H / W"]
    summary = table(["Size", "Vehicles", "Median, σ", "Within 1σ", "2σ", "3σ"], counts)
    return f"{table(head, rows)}\n\n{summary}"


def pages(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """All tables."""
    parts: list[tuple[str, Any]] = [
        ("Against the truth", truth_table),
        ("Movement", label_table),
        ("Repeated runs", repeat_table),
        ("Sizes against the class", size_tables),
    ]
    return "\n\n".join(f"### {title}\n\n{part(clips, results)}" for title, part in parts)


def main() -> None:
    """Runs and judges."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tractrix", default=str(truth.ROOT / "target/release/tractrix"))
    parser.add_argument("--clip", action="append", default=[])
    parser.add_argument("--variant", action="append", default=[])
    args = parser.parse_args()
    version = subprocess.run([args.tractrix, "--version"], capture_output=True, text=True, check=True).stdout
    clips = [clip for clip in find_clips(args.data) if not args.clip or clip.name in args.clip]
    results: dict[str, dict[str, Result]] = {}
    failed = []
    for clip in clips:
        out, results[clip.name] = args.out / clip.name, {}
        out.mkdir(parents=True, exist_ok=True)
        for variant, given in variants(clip, out).items():
            if args.variant and variant not in args.variant:
                continue
            if run(clip, variant, given, out, args.tractrix, version):
                results[clip.name][variant] = Result(clip, variant, out / variant)
            else:
                failed.append(f"{clip.name}, {variant}")
    print(pages(clips, results))
    if failed:
        print(f"\nFailed: {'; '.join(failed)}")


if __name__ == "__main__":
    main()
