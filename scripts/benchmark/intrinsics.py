#!/usr/bin/env python3
"""Camera paths and vehicles with wrong intrinsics, rolling shutter and compression, beside the truth.

    scripts/benchmark/intrinsics.py SEQUENCE... --output DIR [--real FOLDER] [--binary FILE]

Every rendered SEQUENCE is run with its true intrinsics and with perturbed ones, each as a prior (the default) and held
(--fixed); with the true ones also after a simulated rolling shutter and after strong compression. --real is a folder of
a real drive with image_l/, calib.txt and poses.txt (KITTI odometry), run with its calibration, without it, and with
wrong focal lengths.

Camera path: root mean square distance of the centers after a similarity alignment, and the share of the frames within
1, 2, 3 σ of the truth, σ being the run's own (`camera_center_deviation`, median). Ratio: share of the vehicles whose
scale ratio is within 1, 2, 3 of its σ. A rolling shutter of so many milliseconds from the first to the last row is
simulated by a flow between neighboring frames, row by row.

Needs numpy and OpenCV's Python module, and the program ffmpeg. DIR keeps every run; what was run with the same program
and flags is not run again.
"""

import argparse
import hashlib
import json
import shutil
import statistics
import subprocess
import sys
from dataclasses import dataclass
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
SHUTTERS_MS = (10, 30)
# Constant rate factor of H.264: 23 is usual, 35 is that of a poor link.
CRF = 35


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


class Program:
    """The program, and the folder that keeps its runs."""

    def __init__(self, binary: Path, folder: Path) -> None:
        self.binary, self.folder = binary.resolve(), folder
        self.hash = hashlib.sha256(binary.read_bytes()).hexdigest()

    def run(self, name: str, source: Path, flags: list[str]) -> Path:
        """Output folder of a run."""
        output, stamp = self.folder / name, self.folder / f"{name}.json"
        wanted = json.dumps({"program": self.hash, "input": str(source), "flags": flags})
        if not stamp.exists() or stamp.read_text() != wanted:
            shutil.rmtree(output, ignore_errors=True)
            output.parent.mkdir(parents=True, exist_ok=True)
            command = [self.binary, "run", source, "--output", output, "--quiet", *flags]
            with open(self.folder / f"{name}.log", "w") as log:
                code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode
            if code not in (0, 1):
                sys.exit(f"{name} ended with {code}; see {self.folder / name}.log")
            stamp.write_text(wanted)
        return output

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


def result(program: Program, output: Path, truth: dict[str, np.ndarray], sequence: Path | None) -> Result | None:
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


def videos(sequence: Path, scene: dict, folder: Path) -> dict[str, Path]:
    """Degraded videos of a sequence by name, made once."""
    folder.mkdir(parents=True, exist_ok=True)
    fps = scene["fps"]
    made = {f"shutter {ms} ms": folder / f"shutter{ms}.mp4" for ms in SHUTTERS_MS} | {f"CRF {CRF}": folder / "crf.mp4"}
    if not all(path.exists() for path in made.values()):
        frames = frames_of(sequence / "video.mp4")
        for ms in SHUTTERS_MS:
            encode(rolling(frames, fps, ms / 1000), fps, 16, folder / f"shutter{ms}.mp4")
        encode(frames, fps, CRF, folder / "crf.mp4")
    return made


def truth_of(scene: dict) -> dict[str, np.ndarray]:
    """True camera centers by the name of the frame in an output."""
    return {f"{k:06d}.jpg": np.array(frame["T_world_camera"])[:3, 3] for k, frame in enumerate(scene["frames"])}


def rendered(program: Program, sequences: list[Path]) -> dict[tuple[str, str], list[Result]]:
    """Results of all sequences by case and mode."""
    rows: dict[tuple[str, str], list[Result]] = {}
    for sequence in sequences:
        scene = json.loads((sequence / "scene.json").read_text())
        truth, k = truth_of(scene), scene["K"]
        common = ["--masks", str(sequence / "masks"), "--only-object", "1", "--threads", "1"]
        ground = ["--ground-masks", str(sequence / "semantic"), "--ground-label", "3"]
        inputs = [("exact", sequence / "video.mp4", EXACT)]
        inputs += [(name, sequence / "video.mp4", change) for name, change in PERTURBED.items()]
        degraded = videos(sequence, scene, program.folder / "videos" / sequence.name)
        inputs += [(name, video, EXACT) for name, video in degraded.items()]
        for number, (case, video, change) in enumerate(inputs):
            given = ["--intrinsics", intrinsics(k, scene["width"], change)]
            for mode, more in (("prior", []), ("fixed", ["--fixed"])):
                name = f"{sequence.name}-{number}-{mode}"
                output = program.run(name, video, [*common, *ground, *given, *more])
                if found := result(program, output, truth, sequence):
                    rows.setdefault((case, mode), []).append(found)
                    print(f"{sequence.name} {case} {mode}: {found}", file=sys.stderr, flush=True)
    return rows


def percent(shares: list[float]) -> str:
    """Shares as "62/91/99 %"."""
    return "/".join(f"{100 * share:.0f}" for share in shares) + " %"


def table(rows: dict[tuple[str, str], list[Result]]) -> str:
    """The table of the rendered sequences."""
    head = ["Intrinsics, video", "Mode", "Path error, m", "× exact", "σ, m", "Within 1/2/3σ", "Ratio within 1/2/3σ"]
    head += ["Trajectory, m", "Warned"]
    lines = ["| " + " | ".join(head) + " |", "| --- | --- |" + " ---: |" * (len(head) - 2)]
    for (case, mode), found in rows.items():
        exact = rows[("exact", mode)]
        path = statistics.mean(one.path_m for one in found)
        times = statistics.median(one.path_m / other.path_m for one, other in zip(found, exact))
        within = [statistics.mean(one.within[k] for one in found) for k in range(3)]
        ratios = [off for one in found for off in one.ratio_in_std]
        of_ratio = [sum(off <= k for off in ratios) / max(len(ratios), 1) for k in (1, 2, 3)]
        errors = [one.trajectory_m for one in found if one.trajectory_m is not None]
        cells = [case, mode, f"{path:.3f}", f"{times:.2f}", f"{statistics.mean(one.std_m for one in found):.3f}"]
        cells += [percent(within), percent(of_ratio), f"{statistics.mean(errors):.3f}" if errors else "–"]
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
        "with K": scaled(1.0),
        "with K, --fixed": [*scaled(1.0), "--fixed"],
        "without": [],
        "K +1 %": scaled(1.01),
        "K −1 %": scaled(0.99),
        "K +1 %, --fixed": [*scaled(1.01), "--fixed"],
    }
    lines = ["| Intrinsics | Focal length, px | Path error, m | σ, m | Within 1/2/3σ | Meters | σ of meters | Warned |"]
    lines.append("| --- |" + " ---: |" * 7)
    for number, (case, flags) in enumerate(cases.items()):
        height = ["--fps", "10", "--camera-height", "1.65±0.05", "--threads", "1"]
        output = program.run(f"real-{number}", folder / "image_l", [*height, *flags])
        found = result(program, output, truth, None)
        if found is None:
            lines.append(f"| {case} | – | – | – | – | – | – | – |")
            continue
        centers = poses_of(output / "background")
        names = sorted(set(centers) & set(truth))
        _, scale = aligned(np.array([centers[n] for n in names]), np.array([truth[n] for n in names]))
        metric = json.loads((output / "trajectories.json").read_text()).get("metric") or {}
        per_unit, std = metric.get("scale"), (metric.get("std") or {}).get("scale")
        meters = f"{100 * (per_unit / scale - 1):+.1f} %" if per_unit else "–"
        of_meters = f"{100 * std / per_unit:.1f} %" if per_unit and std else "–"
        focal = f"{found.focal:.1f}" + (f" ± {found.focal_std:.1f}" if found.focal_std else "")
        cells = [case, focal, f"{found.path_m:.3f}", f"{found.std_m:.3f}", percent(found.within), meters, of_meters]
        lines.append("| " + " | ".join([*cells, "yes" if found.warned else ""]) + " |")
    return "\n".join(lines)


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="*", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--real", type=Path)
    parser.add_argument("--binary", type=Path, default=Path("target/release/tractrix"))
    args = parser.parse_args()
    program = Program(args.binary, args.output)
    args.output.mkdir(parents=True, exist_ok=True)
    tables = [table(rendered(program, args.sequences))] if args.sequences else []
    tables += [real(program, args.real)] if args.real else []
    print("\n\n".join(tables))


if __name__ == "__main__":
    main()
