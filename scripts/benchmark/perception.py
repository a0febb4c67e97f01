#!/usr/bin/env python3
"""What the program finds by itself: on rendered sequences beside the truth, on clips to count and to look at.

    scripts/benchmark/perception.py rendered SEQUENCE... --output DIR [--binary FILE] [-- FLAGS]
    scripts/benchmark/perception.py clips VIDEO... --output DIR [--truth-boxes FILE] [--compare-model FILE] [-- FLAGS]

`rendered` runs the program on the sequence's video.mp4 with nothing given (with --intrinsics-of-sequence the true K),
and once more with the true masks. A frame counts where at least 60 % (--min-visible) of its outline is visible; the
target is found in it where the mask of one track overlaps its own by at least one half (intersection over union). IoU
is the mean over the frames in which it is found. A switch is a change of the id that finds it. Tracks that never find
the target are `others` where they lie on other vehicles that move, `pieces` on the target, else `false`: in most of
their frames at least half of their pixels have that label.

`clips` counts tracks and trajectories, and draws the masks over eight frames. A file of --truth-boxes holds one line
x,y,width,height per frame, NaN where the object is absent, and belongs to the video with whose name its own begins; the
object is found in a frame where a track's box overlaps its box by at least 0.3. --compare-model adds a run with another
segmentation network; two runs share an object in a frame where their boxes overlap by at least 0.3.

Flags after `--` go to the runs in which the program finds the vehicles itself, those of --every-run "FLAGS" to all.
Needs numpy, Pillow and the program ffmpeg. DIR keeps every run; what was run with the same program and flags is not run
again. The tables are printed and lie in DIR as perception.md and perception.json, overlays as DIR/<name>-<run>.png.
"""

import argparse
import hashlib
import json
import shutil
import statistics
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from contact_sheet import write_sheet
from PIL import Image
from run_output import Box, RunOutput, box_iou
from silhouette import Target

Row = dict[str, Any]

MIN_VISIBLE = 0.6
MIN_MASK_IOU = 0.5
MIN_BOX_IOU = 0.3
MIN_LABEL_SHARE = 0.5
TARGET, OTHER_VEHICLE = 1, 2
# What a track is that never finds the target.
KINDS = ["others", "pieces", "false"]


class Program:
    """The program, and the folder that keeps its runs."""

    def __init__(self, binary: Path, folder: Path, flags: list[str]) -> None:
        if not binary.is_file():
            sys.exit(f"{binary}: no such program; name it with --binary")
        self.binary, self.folder, self.flags = binary.resolve(), folder, flags
        self.hash = hashlib.sha256(self.binary.read_bytes()).hexdigest()

    def run(self, name: str, video: Path, flags: list[str]) -> RunOutput:
        """A run's output; done before where program, input and flags are the same."""
        folder, stamp = self.folder / "runs" / name, self.folder / "runs" / f"{name}.json"
        command = ["run", str(video.resolve()), *flags, *self.flags]
        wanted = {"program": self.hash, "command": command}
        before = json.loads(stamp.read_text()) if stamp.is_file() else None
        if before != wanted | {"done": True}:
            if before and (before["program"], before["command"]) != (self.hash, command):
                shutil.rmtree(folder, ignore_errors=True)
            folder.parent.mkdir(parents=True, exist_ok=True)
            stamp.write_text(json.dumps(wanted | {"done": False}))
            code = self.call([*command, "--output", folder, "--quiet"], folder.parent / f"{name}.log")
            if code not in (0, 1):
                sys.exit(f"{name} ended with {code}; see {folder.parent / name}.log")
            stamp.write_text(json.dumps(wanted | {"done": True}))
        return RunOutput(folder)

    def call(self, arguments: list[str | Path], log: Path) -> int:
        """Runs the program; what it says goes into a file."""
        with open(log, "w") as out:
            return subprocess.run([self.binary, *arguments], stdout=out, stderr=subprocess.STDOUT).returncode

    def trajectory_error(self, output: RunOutput, truth: Path) -> float | None:
        """The trajectory error in metres; None where there is no trajectory of the target."""
        command = [self.binary, "evaluate", output.folder, "--truth", truth, "--json"]
        text = subprocess.run(command, capture_output=True, text=True).stdout
        trajectory = (json.loads(text) if text.strip() else {}).get("trajectory") or {}
        return trajectory.get("mean_m")


def mask_iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two boolean images."""
    both = np.count_nonzero(a | b)
    return np.count_nonzero(a & b) / both if both else 0.0


def switches(ids: list[int]) -> int:
    """How often an id follows another one."""
    return sum(a != b for a, b in zip(ids, ids[1:]))


def kind_of_track(labels: list[np.ndarray]) -> str:
    """On what a track lies that never finds the target, by the labels of its pixels in each of its frames."""
    for kind, label in zip(KINDS, (OTHER_VEHICLE, TARGET)):
        num_on_it = sum(np.mean(frame == label) >= MIN_LABEL_SHARE for frame in labels)
        if 2 * num_on_it > len(labels):
            return kind
    return KINDS[-1]


def best_track(masks: dict[int, np.ndarray], target: np.ndarray) -> tuple[int | None, float]:
    """The track whose mask overlaps the target's most, and by how much."""
    overlaps = {track: mask_iou(mask, target) for track, mask in masks.items()}
    best = max(overlaps, key=overlaps.__getitem__, default=None)
    return best, 0.0 if best is None else overlaps[best]


def against_truth(output: RunOutput, sequence: Path, scene: dict, min_visible: float) -> Row:
    """The target's recall and overlap, and what the other tracks are."""
    target, tracks = Target(sequence, scene), output.ids
    ious, finders, labels = [], [], {track: [] for track in tracks}
    finds_target: set[int] = set()
    for frame in scene["frames"]:
        if frame["index"] >= output.num_frames:
            continue
        label = np.asarray(Image.open(sequence / frame["mask"]))
        masks = {track: output.mask(track, f"{frame['index']:06d}.jpg") for track in tracks}
        masks = {track: mask for track, mask in masks.items() if mask is not None and mask.any()}
        for track, mask in masks.items():
            labels[track].append(label[mask])
        best, iou = best_track(masks, label == TARGET)
        if best is not None and iou >= MIN_MASK_IOU:
            finds_target.add(best)
        if target.visible_share(frame, np.count_nonzero(label == TARGET)) >= min_visible:
            ious.append(iou)
            finders += [best] if iou >= MIN_MASK_IOU else []
    rest = {track: kind_of_track(labels[track]) for track in tracks if track not in finds_target}
    found = [iou for iou in ious if iou >= MIN_MASK_IOU]
    return {
        "visible": len(ious),
        "found": len(found),
        "recall": len(found) / len(ious) if ious else None,
        "iou": statistics.mean(found) if found else None,
        "iou_of_all": statistics.mean(ious) if ious else None,
        "switches": switches(finders),
        "ids": sorted(finds_target),
        "rest": Counter(rest.values()),
        "rest_with_trajectory": Counter(kind for track, kind in rest.items() if track in output.objects),
    }


def rendered_row(program: Program, sequence: Path, arguments: argparse.Namespace) -> Row:
    """One sequence: raw beside given masks."""
    scene = json.loads((sequence / "scene.json").read_text())
    name, video, K = scene.get("name", sequence.name), sequence / "video.mp4", scene["K"]
    common = []
    if arguments.intrinsics_of_sequence:
        common = ["--intrinsics", f"{K[0][0]},{K[1][1]},{K[0][2]},{K[1][2]}"]
    raw = program.run(f"{name}-raw", video, [*common, *arguments.flags])
    given = program.run(f"{name}-given", video, [*common, "--masks", str((sequence / "masks").resolve())])
    write_sheet(video, raw, program.folder / f"{name}-raw.png")
    return {
        "name": name,
        **against_truth(raw, sequence, scene, arguments.min_visible),
        "error_m": program.trajectory_error(raw, sequence),
        "error_with_masks_m": program.trajectory_error(given, sequence),
        "num_frames": raw.num_frames,
        **raw.cost(),
        "cpu_s_with_masks": given.cost()["cpu_s"],
        "failure": raw.run.get("error"),
    }


def read_boxes(path: Path) -> dict[str, np.ndarray]:
    """The annotated boxes (x0, y0, x1, y1) by image name, without the frames in which the object is absent."""
    lines = [np.array(line.split(","), dtype=float) for line in path.read_text().splitlines() if line.strip()]
    return {f"{k:06d}.jpg": np.append(b[:2], b[:2] + b[2:]) for k, b in enumerate(lines) if np.isfinite(b).all()}


def against_boxes(boxes: dict[int, dict[str, Box]], truth: dict[str, np.ndarray]) -> Row:
    """In how many frames one annotated object is found, by which tracks."""
    finders = []
    for name, box in sorted(truth.items()):
        overlaps = {track: box_iou(seen[name], box) for track, seen in boxes.items() if name in seen}
        best = max(overlaps, key=overlaps.__getitem__, default=None)
        finders += [best] if best is not None and overlaps[best] >= MIN_BOX_IOU else []
    recall = len(finders) / len(truth) if truth else None
    return {
        "there": len(truth),
        "found": len(finders),
        "recall": recall,
        "switches": switches(finders),
        "ids": sorted(set(finders)),
    }


def shared(boxes: dict[int, dict[str, Box]], others: dict[int, dict[str, Box]]) -> tuple[int, int]:
    """How many boxes of a run, frame by frame, another run has too, and how many there are."""
    all_boxes = [(name, box) for seen in boxes.values() for name, box in seen.items()]
    has = sum(
        any(box_iou(box, s[name]) >= MIN_BOX_IOU for s in others.values() if name in s) for name, box in all_boxes
    )
    return has, len(all_boxes)


def track_row(output: RunOutput, track: int, boxes: dict[str, Box]) -> Row:
    """One track: its life, its size, and what the program says of it."""
    sides = [np.sqrt((b[2] - b[0]) * (b[3] - b[1])) for b in boxes.values()]
    return {
        "id": track,
        "first": min(boxes, default=None),
        "last": max(boxes, default=None),
        "frames": len(boxes),
        "median_side_px": float(np.median(sides)) if sides else None,
        **output.said(track),
    }


def clip_row(output: RunOutput, boxes: dict[int, dict[str, Box]], truth: dict[str, np.ndarray]) -> Row:
    """One run on one clip."""
    used = {name: box for name, box in truth.items() if int(name[:6]) < output.num_frames}
    return {
        "tracks": [track_row(output, track, seen) for track, seen in boxes.items()],
        "boxes_per_frame": sum(map(len, boxes.values())) / max(1, output.num_frames),
        "trajectories": len(output.objects),
        "annotated": against_boxes(boxes, used) if used else None,
        "num_frames": output.num_frames,
        **output.cost(),
        "failure": output.run.get("error"),
    }


def clip_rows(program: Program, video: Path, arguments: argparse.Namespace) -> list[Row]:
    """One clip: the program's own finding, and beside it that with another network."""
    runs = {"raw": arguments.flags}
    if arguments.compare_model:
        runs["model"] = ["--segmentation-model", str(arguments.compare_model.resolve())]
    outputs = {run: program.run(f"{video.stem}-{run}", video, flags) for run, flags in runs.items()}
    boxes = {run: {track: output.boxes(track) for track in output.ids} for run, output in outputs.items()}
    truth_files = [path for path in arguments.truth_boxes if path.name.startswith(video.stem)]
    truth = read_boxes(truth_files[0]) if truth_files else {}
    rows = []
    for run, output in outputs.items():
        write_sheet(video, output, program.folder / f"{video.stem}-{run}.png")
        beside = {other: shared(boxes[run], boxes[other]) for other in runs if other != run}
        rows.append({"name": video.stem, "run": run, **clip_row(output, boxes[run], truth), "shared": beside})
    return rows


def number(value: float | None, digits: int = 2) -> str:
    """A number for a table; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """A share for a table."""
    return "–" if value is None else f"{100 * value:.0f} %"


def table(lines: list[dict[str, Any]]) -> str:
    """A Markdown table; the lines have the columns' heads as their keys."""
    head = list(lines[0]) if lines else []
    cells = [head, ["---"] * len(head), *(line.values() for line in lines)]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in cells)


def kinds(counts: dict[str, int]) -> str:
    """How many of the tracks that are not the target are what."""
    return " / ".join(str(counts.get(kind, 0)) for kind in KINDS)


def rendered_line(row: Row) -> dict[str, Any]:
    """A sequence in the table."""
    return {
        "sequence": row["name"],
        "found": f"{row['found']} of {row['visible']}",
        "recall": percent(row["recall"]),
        "IoU": number(row["iou"], 3),
        "switches": row["switches"],
        "ids": len(row["ids"]),
        " / ".join(KINDS): kinds(row["rest"]),
        "of these with a trajectory": kinds(row["rest_with_trajectory"]),
        "error m": number(row["error_m"], 3),
        "with given masks m": number(row["error_with_masks_m"], 3),
        "CPU s": number(row["cpu_s"], 1),
        "with given masks s": number(row["cpu_s_with_masks"], 1),
    }


def clip_line(row: Row) -> dict[str, Any]:
    """A run on a clip in the table."""
    annotated = row["annotated"] or {}
    return {
        "clip": row["name"],
        "run": row["run"],
        "tracks": len(row["tracks"]),
        "trajectories": row["trajectories"],
        "boxes per frame": number(row["boxes_per_frame"]),
        "also found by the other run": ", ".join(f"{has} of {num}" for has, num in row["shared"].values()) or "–",
        "annotated found": f"{annotated['found']} of {annotated['there']}" if annotated else "–",
        "recall": percent(annotated.get("recall")),
        "ids": len(annotated.get("ids", [])),
        "switches": annotated.get("switches", "–"),
        "CPU s per frame": number(row["cpu_s"] / max(1, row["num_frames"])),
        "peak MiB": number(row["peak_rss_mib"], 0),
    }


def track_line(row: Row, track: Row) -> dict[str, Any]:
    """A track of a run on a clip in the table."""
    return {
        "clip": row["name"],
        "run": row["run"],
        "id": track["id"],
        "class": track["class"] or "–",
        "finder": words(track["finder"]),
        "moved": words(track["movement"]),
        "frames": track["frames"],
        "from": int(track["first"][:6]),
        "to": int(track["last"][:6]),
        "side px": number(track["median_side_px"], 0),
        "trajectory": "yes" if track["trajectory"] else "no",
    }


def cost_line(row: Row) -> dict[str, Any]:
    """CPU seconds per frame and stage of a run in the table."""
    num = max(1, row["num_frames"])
    return {
        "name": row["name"],
        "run": row.get("run", "raw"),
        **{stage: number(cpu_s / num, 3) for stage, cpu_s in row["stages_cpu_s"].items()},
        "all": number(row["cpu_s"] / num, 3),
        "peak MiB": number(row["peak_rss_mib"], 0),
    }


def tables(kind: str, rows: list[Row]) -> str:
    """All tables of a run of this script."""
    if kind == "rendered":
        parts = [[rendered_line(row) for row in rows]]
    else:
        tracks = [track_line(row, track) for row in rows for track in row["tracks"] if track["frames"]]
        parts = [[clip_line(row) for row in rows], tracks]
    return "\n\n".join(table(part) for part in [*parts, [cost_line(row) for row in rows]] if part) + "\n"


def words(value: Any) -> str:
    """Whatever the program says, in one cell."""
    if isinstance(value, dict):
        return ", ".join(f"{key} {words(entry)}" for key, entry in value.items())
    return "–" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def parsed() -> argparse.Namespace:
    """The command line; what stands behind `--` goes to the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    rendered = kinds.add_parser("rendered", help="sequences with a scene.json")
    rendered.add_argument("inputs", nargs="+", type=Path, metavar="SEQUENCE")
    rendered.add_argument("--intrinsics-of-sequence", action="store_true", help="give the true K")
    rendered.add_argument("--min-visible", type=float, default=MIN_VISIBLE, help="share of the outline that counts")
    clips = kinds.add_parser("clips", help="videos")
    clips.add_argument("inputs", nargs="+", type=Path, metavar="VIDEO")
    clips.add_argument("--truth-boxes", type=Path, action="append", default=[], metavar="FILE")
    clips.add_argument("--compare-model", type=Path, metavar="FILE", help="another network, in a run of its own")
    for kind in (rendered, clips):
        kind.add_argument("--binary", type=Path, default=Path("target/release/tractrix"))
        kind.add_argument("--output", type=Path, required=True, metavar="DIR")
        kind.add_argument("--every-run", default="", metavar="FLAGS", help="flags of all runs, as one word")
    given = sys.argv[1:]
    end = given.index("--") if "--" in given else len(given)
    arguments = parser.parse_args(given[:end])
    arguments.flags = given[end + 1 :]
    return arguments


def main() -> None:
    arguments = parsed()
    arguments.output.mkdir(parents=True, exist_ok=True)
    program = Program(arguments.binary, arguments.output, arguments.every_run.split())
    rows: list[Row] = []
    for given in arguments.inputs:
        rows += (
            [rendered_row(program, given, arguments)]
            if arguments.kind == "rendered"
            else clip_rows(program, given, arguments)
        )
        print(f"{given}: done", file=sys.stderr, flush=True)
    text = tables(arguments.kind, rows)
    (arguments.output / "perception.md").write_text(text)
    (arguments.output / "perception.json").write_text(json.dumps(rows, indent=1))
    print(text, end="")


if __name__ == "__main__":
    main()
