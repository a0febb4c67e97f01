#!/usr/bin/env python3
"""Runs real clips in several ways, compares them with the truth and with one another, and prints the tables.

    scripts/benchmark/real.py DATA OUT [--tractrix target/release/tractrix] [--clip NAME]... [--variant NAME]... [--all]

DATA/real has clips with truth: folders with image_l/, calib.txt and poses.txt (the KITTI odometry benchmark's form) and
GoPro videos; DATA/videos has clips without, with truth/NAME.target_2d.txt (boxes of one moving vehicle) and
truth/NAME_intrinsics*.json where known. `parked` in a clip's name: all its vehicles are stationary. Clips of more than
60 frames have only those variants that their truth judges, unless --all. Variants that are done with the same program
are not run again (OUT/CLIP/VARIANT.done). Each runs with one thread at low priority. OUT/CLIP/pictures has frames of
the whole clip with outlines, trajectories and ground tracks drawn in.

Needs numpy, Pillow, ffmpeg and ffprobe. Run by `scripts/benchmark/all`, which writes the page.
"""

import argparse
import functools
import json
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
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
# Longer clips have their repeated runs only with --all: they take an hour.
SHORT_FRAMES = 60
# Longer side of the reduced images of clips with an annotated vehicle, pixels.
REDUCED_PX = 640
REDUCED, STATIONARY = f"{REDUCED_PX} px", "known to be stationary"
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


def variants(clip: Clip, out: Path, is_all: bool) -> dict[str, list[str]]:
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
    if not (is_all or clip.num_frames <= SHORT_FRAMES):
        found = {"whole": whole}
    if clip.receiver:
        found["no telemetry"] = [*whole, "--no-telemetry"]
    if clip.is_parked:
        found[STATIONARY] = [*whole, "--set", "tuning.scale.stationary=all"]
    if clip.target:
        found[REDUCED] = [*whole, "--max-dimension", str(REDUCED_PX)]
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
    if variant == STATIONARY and not folder.exists() and (whole := out / "whole").exists():
        # Nothing before the scale ratios differs.
        shutil.copytree(whole, folder)
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

    @property
    def metric_ground_tracks(self) -> list[dict[str, Any]]:
        """Ground tracks as the file has them."""
        return self.trajectories.get("ground_tracks", [])

    @functools.cached_property
    def ground_tracks(self) -> dict[int, dict[int, np.ndarray]]:
        """Positions of ground tracks, units, by index of the frame."""
        found = {}
        for entry in self.metric_ground_tracks:
            found[entry["id"]] = {self.index(at["name"]): np.array(at["position"]) for at in entry["frames"]}
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
            judged = [(variant, found) for variant, found in results[clip.name].items() if variant != STATIONARY]
            rows += [[clip.name, variant, *judge(clip, found)] for variant, found in judged]
    head = ["Clip", "Variant", "Registered", "Path, RMS", "Rotation, RMS", "Scale drift", "Meters per unit (σ)"]
    return table(head, rows)


def target_boxes(clip: Clip, result: Result) -> dict[int, Box]:
    """Boxes of the annotated vehicle in pixels of the run, every third frame."""
    rows = [np.fromstring(line, sep=",") for line in clip.target.read_text().splitlines()]
    factor = result.output.size[0] / int(clip.probed("width"))
    boxes = {i: factor * np.array([x, y, x + w, y + h]) for i, (x, y, w, h) in enumerate(rows) if np.isfinite(x)}
    return {i: tuple(box) for i, box in boxes.items() if i % EVERY == 0}


def recall_table(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """Share of the annotated vehicle's frames with a mask, a usable trajectory, and a ground track."""
    rows = []
    for clip, variant, result in whole_clips(clips, results):
        if not clip.target:
            continue
        boxes = target_boxes(clip, result)
        hits = [(i, track) for track, found in result.boxes.items() for i in boxes.keys() & found.keys()]
        hits = [(i, track) for i, track in hits if box_iou(result.boxes[track][i], boxes[i]) > MIN_IOU]
        usable = [(i, t) for i, t in hits if result.verdict(t) != "rejected" and i in result.distances.get(t, {})]
        on_ground = [(i, track) for i, track in hits if i in result.ground_tracks.get(track, {})]
        shares = [f"{100 * len({i for i, _ in found}) / len(boxes):.0f} %" for found in (hits, usable, on_ground)]
        width = np.median([box[2] - box[0] for box in boxes.values()])
        states = ", ".join(sorted({result.state(track) for _, track in hits})) or "–"
        rows.append([clip.name, variant, f"{width:.0f} px", *shares, states])
    return table(["Clip", "Variant", "Width", "Mask", "Trajectory", "Ground track", "Movement"], rows)


def stationary_table(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """Ratios of vehicles that are known to be stationary, without the camera path against with it."""
    rows = []
    for clip in clips:
        result = results[clip.name].get(STATIONARY)
        for track, entry in sorted(result.output.objects.items()) if result else []:
            path = entry["scale"].get("camera_path")
            if not path:
                rows.append([clip.name, str(track), "–", "–", "–", str(result.verdict(track))])
                continue
            error = np.log(path["ratio_without"] / path["ratio"])
            std = (path["std_without"] or 0.0) / path["ratio_without"]
            cells = [f"{percent(error)} (±{100 * std:.1f} %)", f"{abs(error) / std:.1f}" if std else "–"]
            rows.append([clip.name, str(track), *cells, f"{100 * path['residual']:.2f} %", str(result.verdict(track))])
    return table(["Clip", "Vehicle", "Error of the ratio (σ)", "In σ", "Residual", "Verdict"], rows)


def whole_clips(clips: list[Clip], results: dict[str, dict[str, Result]]) -> Iterator[tuple[Clip, str, Result]]:
    """Runs of whole clips that differ in what the program is told."""
    for clip in clips:
        for variant, result in results[clip.name].items():
            if variant in ("whole", "no intrinsics", "no telemetry", REDUCED):
                yield clip, variant, result


def label_table(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """Movement and verdicts of all tracks of the whole clips."""
    rows = []
    for clip, variant, result in whole_clips(clips, results):
        states = Counter(result.state(track) for track in result.output.tracked)
        verdicts = Counter(result.verdict(track) for track in result.output.objects)
        counts = [str(states[state]) for state in ("stationary", "undetermined", "moving")]
        order = [name for name in ("good", "fair", "doubtful", "rejected") if verdicts[name]]
        shown = ", ".join(f"{verdicts[name]} {name}" for name in order)
        on_ground = Counter((track.get("verdict") or {}).get("state") for track in result.metric_ground_tracks)
        order = [name for name in ("usable", "coarse", "inconsistent") if on_ground[name]]
        also = ", ".join(f"{on_ground[name]} {name}" for name in order)
        known = "all stationary" if clip.is_parked else "–"
        rows.append([clip.name, variant, known, *counts, shown or "none", also or "none"])
    head = ["Clip", "Variant", "Truth", "Stationary", "Undetermined", "Moving", "Trajectories", "Ground tracks"]
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
            apart = ("whole", STATIONARY, REDUCED)
            others = [(name, found) for name, found in results[clip.name].items() if name not in apart]
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


def draw(tractrix: str, result: Result, folder: Path) -> None:
    """Writes the frames with most ground tracks in each third of a clip, with all results drawn in."""
    export = [tractrix, "export", str(result.output.folder), "--format", "video", "--quiet"]
    if subprocess.run([*export, "--output", str(folder)], check=False).returncode != 0:
        return
    counts = Counter(i for positions in result.ground_tracks.values() for i in positions)
    frames = sorted(result.centers)
    for third in np.array_split(frames, 3):
        best = max(map(int, third), key=lambda i: (counts[i], -abs(i - int(third[len(third) // 2]))), default=0)
        cut = ["-vf", f"select=eq(n\\,{best})", "-frames:v", "1", str(folder / f"{best:06d}.png")]
        subprocess.run(["ffmpeg", "-v", "error", "-y", "-i", str(folder / "annotated.mp4"), *cut], check=False)


def pages(clips: list[Clip], results: dict[str, dict[str, Result]]) -> str:
    """All tables."""
    parts: list[tuple[str, Any]] = [
        ("Against the truth", truth_table),
        ("Movement", label_table),
        ("Annotated vehicle", recall_table),
        ("Stationary vehicles and the camera path", stationary_table),
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
    parser.add_argument("--all", action="store_true")
    args = parser.parse_args()
    version = subprocess.run([args.tractrix, "--version"], capture_output=True, text=True, check=True).stdout
    clips = [clip for clip in find_clips(args.data) if not args.clip or clip.name in args.clip]
    results: dict[str, dict[str, Result]] = {}
    failed = []
    for clip in clips:
        out, results[clip.name] = args.out / clip.name, {}
        out.mkdir(parents=True, exist_ok=True)
        for variant, given in variants(clip, out, args.all).items():
            if args.variant and variant not in args.variant:
                continue
            if run(clip, variant, given, out, args.tractrix, version):
                results[clip.name][variant] = Result(clip, variant, out / variant)
            else:
                failed.append(f"{clip.name}, {variant}")
        if whole := results[clip.name].get("whole"):
            draw(args.tractrix, whole, out / "pictures")
    print(pages(clips, results))
    if failed:
        print(f"\nFailed: {'; '.join(failed)}")


if __name__ == "__main__":
    main()
