#!/usr/bin/env python3
"""Camera paths and vehicles with wrong intrinsics, rolling shutter and compression, beside the truth.

    scripts/benchmark/intrinsics.py SEQUENCE... --output DIR [--camera-path] [--real FOLDER] [--binary FILE]

Every rendered SEQUENCE is run with its true intrinsics and with perturbed ones, each as a prior (the default) and held
(--fixed); with the true ones also after a simulated rolling shutter and after strong compression. --real is a folder of
a real drive with image_l/, calib.txt and poses.txt (KITTI odometry), run with its calibration, without it, and with
wrong focal lengths. --camera-path leaves out the vehicles (`tractrix sfm`); --case and --mode select.

Camera path: root mean square distance of the centers after a similarity alignment, and the share of the frames within
1, 2, 3 σ of the truth, σ being the run's own (`camera_center_deviation`, median). Ratio: share of the vehicles whose
scale ratio is within 1, 2, 3 of its σ. A rolling shutter of so many milliseconds from the first to the last row is
simulated by a flow between neighboring frames, row by row.

Needs numpy and OpenCV's Python module, and the program ffmpeg. DIR keeps the last run of every video and all results;
what was run with the same program and flags is not run again.
"""

import argparse
import functools
import hashlib
import itertools
import json
import statistics
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

# Change of (f, cx, cy, k1): focal length and center as shares of f and of the width.
PERTURBED = {
    "f +0.5 %": (0.005, 0.0, 0.0, 0.0),
    "f −1 %": (-0.01, 0.0, 0.0, 0.0),
    "f +2 %": (0.02, 0.0, 0.0, 0.0),
    "center +1 %, −1 %": (0.0, 0.01, -0.01, 0.0),
    "k1 +0.05": (0.0, 0.0, 0.0, 0.05),
    "k1 −0.05": (0.0, 0.0, 0.0, -0.05),
}
EXACT = (0.0, 0.0, 0.0, 0.0)
# Readout in milliseconds and constant rate factor of H.264: 16 keeps the images, 23 is usual, 35 is a poor link.
DEGRADED = {"shutter 10 ms": (10, 16), "shutter 30 ms": (30, 16), "CRF 35": (0, 35)}


@dataclass
class Result:
    """Figures of a run."""

    path_m: float
    std_m: float
    within: list[float]
    ratio_in_std: list[float]
    trajectory_m: float | None
    focal: float
    focal_std: float | None
    cpu_s: float
    warned: bool
    fit: dict | None
    per_unit: float | None
    per_unit_std: float | None


class Program:
    """The program, and the folder that keeps its results."""

    def __init__(self, binary: Path, folder: Path, command: str) -> None:
        self.binary, self.folder, self.command = binary.resolve(), folder, command
        self.hash = hashlib.sha256(binary.read_bytes()).hexdigest()

    def run(self, name: str, source: Path, flags: list[str]) -> Path:
        """Runs the program; returns the output folder. One name has one video, so that its features are kept."""
        output = self.folder / name
        command = [self.binary, self.command, source, "--output", output, "--quiet", "--threads", "1", *flags]
        with open(self.folder / f"{name}.log", "w") as log:
            code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode
        if code not in (0, 1):
            sys.exit(f"{name} ended with {code}; see {self.folder / name}.log")
        return output

    def result(self, name: str, case: str, source: Path, flags: list[str], measure: Callable) -> "Result | None":
        """Result of a run, kept under the name of the case; `measure` makes it of the output folder."""
        stamp = self.folder / f"{name}-{case}.json"
        wanted = {"program": self.hash, "command": self.command, "input": str(source), "flags": flags}
        kept = json.loads(stamp.read_text()) if stamp.exists() else {}
        if kept.get("run") != wanted:
            found = measure(self.run(name, source, flags))
            kept = {"run": wanted, "result": asdict(found) if found else None}
            stamp.write_text(json.dumps(kept))
        return Result(**kept["result"]) if kept["result"] else None

    def evaluate(self, output: Path, truth: Path) -> dict:
        """What `tractrix evaluate` says of a run."""
        command = [self.binary, "evaluate", output, "--truth", truth, "--json"]
        return json.loads(subprocess.run(command, capture_output=True, text=True).stdout or "{}")


def poses_of(model: Path) -> dict[str, np.ndarray]:
    """Camera centers of a COLMAP text model by image name."""
    lines = [line.split() for line in (model / "images.txt").read_text().splitlines() if not line.startswith("#")]
    centers = {}
    for fields in lines[::2]:
        w, x, y, z, *t = map(float, fields[1:8])
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        centers[fields[9]] = -rotation.T @ np.array(t)
    return centers


def aligned(found: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, float]:
    """Distances of centers after the best similarity, and its scale."""
    a, b = found - found.mean(0), truth - truth.mean(0)
    u, s, v = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    scale = float((s * np.diag(sign)).sum() / (a * a).sum())
    return np.linalg.norm(scale * a @ (u @ sign @ v).T - b, axis=1), scale


def measured(program: Program, truth: dict[str, np.ndarray], sequence: Path | None, output: Path) -> Result | None:
    """Figures of a run; None without a background."""
    run = json.loads((output / "run.json").read_text())
    figures = run["stages"]["background"]["figures"]
    found = poses_of(output / "background")
    names = sorted(set(found) & set(truth))
    if len(names) < 3:
        return None
    errors, scale = aligned(np.array([found[name] for name in names]), np.array([truth[name] for name in names]))
    std = (figures.get("camera_center_deviation") or {}).get("median", 0.0) * scale
    evaluated = program.evaluate(output, sequence) if sequence else {}
    ratio = evaluated.get("scale") or {}
    off = [abs(ratio["deviation"]) * ratio["ratio"] / ratio["std"]] if ratio.get("std") else []
    result = output / "trajectories.json"
    metric = (json.loads(result.read_text()).get("metric") or {}) if result.exists() else {}
    per_unit, per_unit_std = metric.get("scale"), (metric.get("std") or {}).get("scale")
    return Result(
        path_m=float(np.sqrt((errors**2).mean())),
        std_m=std,
        within=[float((errors <= k * std).mean()) for k in (1, 2, 3)],
        ratio_in_std=off,
        trajectory_m=(evaluated.get("trajectory") or {}).get("mean_m"),
        focal=figures["focal_length_px"],
        focal_std=figures.get("focal_std_px"),
        cpu_s=run["stages"]["background"]["cpu_s"],
        warned=any("does not fit" in json.dumps(warning) for warning in run["warnings"]),
        fit=figures.get("calibration_fit"),
        per_unit=per_unit and per_unit / scale,
        per_unit_std=per_unit_std and per_unit_std / per_unit,
    )


def intrinsics(k: list[list[float]], width: int, change: tuple[float, float, float, float]) -> str:
    """The flag's value for a perturbed camera."""
    f, cx, cy, k1 = change
    focal = k[0][0] * (1 + f), k[1][1] * (1 + f)
    center = k[0][2] + cx * width, k[1][2] + cy * width
    return ",".join(f"{value:.6g}" for value in (*focal, *center, k1, 0.0))


def frames_of(video: Path) -> list[np.ndarray]:
    """All frames of a video."""
    capture, frames = cv2.VideoCapture(str(video)), []
    while (read := capture.read())[0]:
        frames.append(read[1])
    return frames


def encode(frames: list[np.ndarray], fps: float, crf: int, video: Path) -> None:
    """Writes frames as H.264."""
    height, width = frames[0].shape[:2]
    raw = ["-f", "rawvideo", "-pix_fmt", "bgr24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-"]
    command = ["ffmpeg", "-y", "-loglevel", "error", *raw, "-c:v", "libx264", "-crf", str(crf), "-pix_fmt", "yuv420p"]
    subprocess.run([*command, str(video)], input=b"".join(f.tobytes() for f in frames), check=True)


def rolling(frames: list[np.ndarray], fps: float, readout_s: float) -> list[np.ndarray]:
    """Frames whose rows are read one after the other, the middle one at the frame's time."""
    flow_of = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    gray = [cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in frames]
    height, width = gray[0].shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    # Time of a row in frames; what is at a pixel then is found where it comes from.
    time = (y / height - 0.5) * np.float32(readout_s * fps)
    out = []
    for k, frame in enumerate(frames):
        later = flow_of.calc(gray[k], gray[min(k + 1, len(gray) - 1)], None)
        before = flow_of.calc(gray[k], gray[max(k - 1, 0)], None)
        step = np.where(time[..., None] >= 0, later * time[..., None], -before * time[..., None])
        out.append(
            cv2.remap(frame, x - step[..., 0], y - step[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )
    return out


def degraded(sequence: Path, scene: dict, case: str, folder: Path) -> Path:
    """The video of a case, made once."""
    if case not in DEGRADED:
        return sequence / "video.mp4"
    readout_ms, crf = DEGRADED[case]
    video = folder / (f"shutter{readout_ms}.mp4" if readout_ms else "crf.mp4")
    if not video.exists():
        folder.mkdir(parents=True, exist_ok=True)
        frames, fps = frames_of(sequence / "video.mp4"), scene["fps"]
        encode(rolling(frames, fps, readout_ms / 1000) if readout_ms else frames, fps, crf, video)
    return video


def truth_of(scene: dict) -> dict[str, np.ndarray]:
    """True camera centers by the name of the frame in an output."""
    return {f"{k:06d}.jpg": np.array(frame["T_world_camera"])[:3, 3] for k, frame in enumerate(scene["frames"])}


MODES = {"prior": [], "fixed": ["--fixed"]}
CASES = {"exact": EXACT, **PERTURBED, **dict.fromkeys(DEGRADED, EXACT)}


def rendered(
    program: Program, sequences: list[Path], wanted: list[str], modes: list[str]
) -> dict[tuple[str, str], list[Result]]:
    """Results of all sequences by case and mode."""
    rows: dict[tuple[str, str], list[Result]] = {}
    for mode, (number, (case, change)) in itertools.product(modes, enumerate(CASES.items())):
        for sequence in sequences if case in wanted else []:
            scene = json.loads((sequence / "scene.json").read_text())
            video = degraded(sequence, scene, case, program.folder / "videos" / sequence.name)
            flags = ["--masks", str(sequence / "masks"), "--only-object", "1"]
            evaluated = sequence if program.command == "run" else None
            if evaluated:
                flags += ["--ground-masks", str(sequence / "semantic"), "--ground-label", "3"]
            flags += ["--intrinsics", intrinsics(scene["K"], scene["width"], change), *MODES[mode]]
            name, measure = (
                f"{sequence.name}-{video.stem}",
                functools.partial(measured, program, truth_of(scene), evaluated),
            )
            if found := program.result(name, f"{number}-{mode}", video, flags, measure):
                rows.setdefault((case, mode), []).append(found)
                print(f"{sequence.name} {case} {mode}: {found}", file=sys.stderr, flush=True)
    return rows


def percent(shares: list[float]) -> str:
    """Shares as "62/91/99 %"."""
    return "/".join(f"{100 * share:.0f}" for share in shares) + " %"


def table(rows: dict[tuple[str, str], list[Result]], with_vehicles: bool) -> str:
    """The table of the rendered sequences."""
    head = ["Intrinsics, video", "Mode", "Path error, m", "× exact, median and largest", "σ, m", "Within 1/2/3σ"]
    head += (["Ratio within 1/2/3σ", "Trajectory, m"] if with_vehicles else []) + ["Warned"]
    lines = ["| " + " | ".join(head) + " |", "| --- | --- |" + " ---: |" * (len(head) - 2)]
    for (case, mode), found in rows.items():
        exact = rows.get(("exact", mode), found)
        path = statistics.mean(one.path_m for one in found)
        times = [one.path_m / other.path_m for one, other in zip(found, exact)]
        within = [statistics.mean(one.within[k] for one in found) for k in range(3)]
        cells = [case, mode, f"{path:.3f}", f"{statistics.median(times):.2f}, {max(times):.2f}"]
        cells += [f"{statistics.mean(one.std_m for one in found):.3f}", percent(within)]
        if with_vehicles:
            ratios = [off for one in found for off in one.ratio_in_std]
            of_ratio = [sum(off <= k for off in ratios) / max(len(ratios), 1) for k in (1, 2, 3)]
            errors = [one.trajectory_m for one in found if one.trajectory_m is not None]
            cells += [percent(of_ratio), f"{statistics.mean(errors):.3f}" if errors else "–"]
        lines.append("| " + " | ".join([*cells, f"{sum(one.warned for one in found)} of {len(found)}"]) + " |")
    return "\n".join(lines)


def real(program: Program, folder: Path) -> str:
    """The table of a real drive."""
    fx, _, cx, _, _, fy, cy, *_ = map(float, (folder / "calib.txt").read_text().split()[:12])
    poses = np.array([list(map(float, line.split())) for line in (folder / "poses.txt").read_text().splitlines()])
    images = sorted((folder / "image_l").iterdir())
    truth = {image.name: pose.reshape(3, 4)[:, 3] for image, pose in zip(images, poses)}
    # OpenCV counts pixels from the center of the first one.
    scaled = lambda factor: ["--intrinsics", f"{fx * factor},{fy * factor},{cx + 0.5},{cy + 0.5}"]  # noqa: E731
    cases = {
        "K": scaled(1.0),
        "K, `--fixed`": [*scaled(1.0), "--fixed"],
        "none": [],
        "K +1 %": scaled(1.01),
        "K −1 %": scaled(0.99),
        "K +3 %": scaled(1.03),
        "K +1 %, `--fixed`": [*scaled(1.01), "--fixed"],
    }
    head = "| Intrinsics | Focal length, px | Path error, m | σ, m | Within 1/2/3σ | Meters | σ of meters | Warned |"
    lines = [head, "| --- |" + " ---: |" * 7]
    for number, (case, flags) in enumerate(cases.items()):
        flags = ["--fps", "10", "--camera-height", "1.65±0.05", *flags]
        measure = functools.partial(measured, program, truth, None)
        found = program.result(folder.name, str(number), folder / "image_l", flags, measure)
        if found is None:
            lines.append(f"| {case} | – | – | – | – | – | – | – |")
            continue
        meters = f"{100 * (found.per_unit - 1):+.1f} %" if found.per_unit else "–"
        of_meters = f"{100 * found.per_unit_std:.1f} %" if found.per_unit_std else "–"
        focal = f"{found.focal:.1f}" + (f" ± {found.focal_std:.1f}" if found.focal_std else "")
        cells = [case, focal, f"{found.path_m:.3f}", f"{found.std_m:.3f}", percent(found.within), meters, of_meters]
        lines.append("| " + " | ".join([*cells, "yes" if found.warned else ""]) + " |")
    return "\n".join(lines)


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="*", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--camera-path", action="store_true")
    parser.add_argument("--case", action="append", choices=CASES)
    parser.add_argument("--mode", action="append", choices=MODES)
    parser.add_argument("--real", type=Path)
    parser.add_argument("--binary", type=Path, default=Path("target/release/tractrix"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    program = Program(args.binary, args.output, "sfm" if args.camera_path else "run")
    tables = []
    if args.sequences:
        rows = rendered(program, args.sequences, args.case or list(CASES), args.mode or list(MODES))
        tables.append(table(rows, not args.camera_path))
    tables += [real(Program(args.binary, args.output, "run"), args.real)] if args.real else []
    print("\n\n".join(tables))


if __name__ == "__main__":
    main()
