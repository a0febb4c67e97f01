"""Proof of a sequence's ground truth from its files alone.

The object's mesh is projected with the poses and compared with the masks, the
ground mesh with the object's wheels and with rays through ground pixels, the
time stamps with the video.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from .labels import GROUND, OTHER, STATIC, TARGET
from .mesh import read_ply
from .outline import in_camera, silhouette, visible_share, whole_pixels

MIN_IOU = 0.95
OCCLUDED_SHARE = 0.02
MAX_WHEEL_GAP_M = 0.09
MAX_TIME_ERROR_S = 1e-3
MIN_TARGET_SHARE = 0.002
MIN_TARGET_PX = 60
OUTLINE_SLACK_PX = 0.4
MAX_SHARE_ERROR = 0.01
MIN_VISIBLE, MIN_VISIBLE_FRAMES = 0.3, 15
DASHCAM_HEIGHT_M, DASHCAM_VIEW_DEG = (1.25, 1.65), (60.0, 90.0)


@dataclass
class Report:
    """What was found: figures by name, and everything that is wrong."""

    name: str
    figures: dict[str, float] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)

    def demand(self, good: bool, fault: str) -> None:
        """Notes a fault unless ``good``."""
        if not good:
            self.faults.append(fault)


@dataclass
class Sequence:
    """A sequence's files in memory."""

    folder: Path
    scene: dict
    mesh: tuple[np.ndarray, np.ndarray]
    ground: tuple[np.ndarray, np.ndarray]

    @property
    def k(self) -> np.ndarray:
        """Intrinsics (3x3)."""
        return np.array(self.scene["K"])

    def labels(self, frame: dict, kind: str) -> np.ndarray:
        """A label map of a frame (``mask`` or ``semantic``)."""
        image = cv2.imread(str(self.folder / frame[kind]), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise OSError(f"{self.folder / frame[kind]}: missing or not a picture")
        return image


def load(folder: Path) -> Sequence:
    """Reads scene.json and the meshes."""
    scene = json.loads((folder / "scene.json").read_text())
    return Sequence(folder, scene, read_ply(folder / "object_mesh.ply"), read_ply(folder / "ground_mesh.ply"))


def _check_masks(sequence: Sequence, report: Report) -> None:
    """IoU of projected mesh and mask, where nothing stands in front."""
    overlaps, shares, sizes = [], [], []
    watched = sequence.scene.get("target_always_in_picture", True)
    for frame in sequence.scene["frames"]:
        mask, semantic = sequence.labels(frame, "mask"), sequence.labels(frame, "semantic")
        report.demand(
            bool(((mask == TARGET) == (semantic == TARGET)).all()), f"frame {frame['index']}: mask and semantic differ"
        )
        report.demand(bool(((mask == OTHER) == (semantic == OTHER)).all()), f"frame {frame['index']}: others differ")
        points = in_camera(sequence.mesh[0], np.array(frame["T_world_camera"]), np.array(frame["T_world_object"]))
        drawn = silhouette(points, sequence.mesh[1], sequence.k, mask.shape)
        target = mask == TARGET
        inner = cv2.erode(drawn.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
        # A moving vehicle hides the target from its outline inwards; static pixels at the outline are mostly behind it.
        hides = (inner & ~target & (semantic == STATIC)) | (drawn & (semantic == OTHER))
        hidden = hides.sum() / max(1, drawn.sum())
        overlap = (drawn & target).sum() / max(1, (drawn | target).sum())
        shares.append(hidden)
        sizes.append(np.ptp(np.nonzero(target.any(0))[0]) if target.any() else 0)
        seen = target.mean() > MIN_TARGET_SHARE if watched else target.any() or drawn.sum() < MIN_TARGET_PX
        report.demand(bool(seen) or hidden > 0.5, f"frame {frame['index']}: target hardly seen")
        if hidden < OCCLUDED_SHARE and drawn.sum() >= MIN_TARGET_PX:
            overlaps.append(overlap)
            good = overlap > least_overlap(drawn)
            report.demand(good, f"frame {frame['index']}: IoU {overlap:.3f} of projected mesh and mask")
    report.figures |= {
        "iou_min": float(min(overlaps, default=0)),
        "iou_mean": float(np.mean(overlaps or [0])),
        "frames_occluded": float(sum(s >= OCCLUDED_SHARE for s in shares)),
        "hidden_max": float(max(shares)),
        "width_px_min": float(min(sizes)),
        "width_px_max": float(max(sizes)),
    }
    report.demand(bool(overlaps), "no frame shows the target unoccluded")


def least_overlap(drawn: np.ndarray) -> float:
    """Least IoU asked of a silhouette: a fraction of a pixel along the outline may differ, more so in small ones."""
    inner = cv2.erode(drawn.astype(np.uint8), np.ones((3, 3), np.uint8))
    outline = drawn.sum() - inner.sum()
    return min(MIN_IOU, 1 - OUTLINE_SLACK_PX * float(outline) / float(drawn.sum()))


def _check_visibility(sequence: Sequence, report: Report) -> None:
    """The shares written are those of mask and whole silhouette, and the target is seen in enough frames."""
    frames = sequence.scene["frames"]
    if "visible_share" not in frames[0]:
        return
    errors = [abs(frame["visible_share"] - _share(sequence, frame)) for frame in frames]
    shares = np.array([frame["visible_share"] for frame in frames])
    report.figures |= {
        "visible_share_min": float(shares.min()),
        "frames_hidden": float((shares == 0).sum()),
        "frames_visible": float((shares >= MIN_VISIBLE).sum()),
    }
    report.demand(max(errors) < MAX_SHARE_ERROR, f"visible_share is {max(errors):.3f} off mask and mesh")
    enough = (shares >= MIN_VISIBLE).sum() >= min(MIN_VISIBLE_FRAMES, len(frames) / 2)
    report.demand(bool(enough), f"the target is visible in {int((shares >= MIN_VISIBLE).sum())} frames only")


def _share(sequence: Sequence, frame: dict) -> float:
    """The target's visible share in a frame, from mask and mesh."""
    mask = sequence.labels(frame, "mask")
    points = in_camera(sequence.mesh[0], np.array(frame["T_world_camera"]), np.array(frame["T_world_object"]))
    return visible_share(int((mask == TARGET).sum()), whole_pixels(points, sequence.mesh[1], sequence.k, mask.shape))


def _ground_heights(ground: tuple[np.ndarray, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Height of the highest triangle over each plane point (N, 2); NaN beside the mesh."""
    vertices, triangles = ground
    corners = vertices[triangles]
    heights = np.full(len(points), np.nan)
    low, high = corners[:, :, :2].min(1), corners[:, :, :2].max(1)
    for i, p in enumerate(points):
        near = corners[((low <= p) & (p <= high)).all(1)]
        a, e1, e2 = near[:, 0, :2], near[:, 1, :2] - near[:, 0, :2], near[:, 2, :2] - near[:, 0, :2]
        det = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
        det = np.where(np.abs(det) < 1e-12, np.nan, det)
        q = p - a
        u = (q[:, 0] * e2[:, 1] - q[:, 1] * e2[:, 0]) / det
        v = (e1[:, 0] * q[:, 1] - e1[:, 1] * q[:, 0]) / det
        z = near[:, 0, 2] + u * (near[:, 1, 2] - near[:, 0, 2]) + v * (near[:, 2, 2] - near[:, 0, 2])
        inside = (u >= -1e-6) & (v >= -1e-6) & (u + v <= 1 + 1e-6)
        if inside.any():
            heights[i] = z[inside].max()
    return heights


def _check_wheels(sequence: Sequence, report: Report) -> None:
    """The mesh's lowest points under the wheels touch the ground mesh."""
    vertices = sequence.mesh[0]
    contacts = []
    for quadrant_x in (-1, 1):
        for quadrant_y in (-1, 1):
            part = vertices[(np.sign(vertices[:, 0]) == quadrant_x) & (np.sign(vertices[:, 1]) == quadrant_y)]
            contacts.append(part[part[:, 2] < part[:, 2].min() + 0.004].mean(0))
    gaps = []
    for frame in sequence.scene["frames"]:
        pose = np.array(frame["T_world_object"])
        world = np.array(contacts) @ pose[:3, :3].T + pose[:3, 3]
        gaps.append(world[:, 2] - _ground_heights(sequence.ground, world[:, :2]))
    gaps = np.array(gaps)
    report.demand(bool(np.isfinite(gaps).all()), "the ground mesh does not reach under all wheels")
    report.figures |= {"wheel_gap_max_m": float(np.nanmax(np.abs(gaps))), "wheel_gap_mean_m": float(np.nanmean(gaps))}
    report.demand(
        bool(np.nanmax(np.abs(gaps)) < MAX_WHEEL_GAP_M), f"a wheel is {np.nanmax(np.abs(gaps)):.3f} m off the ground"
    )


def _check_ground(sequence: Sequence, report: Report) -> None:
    """Vertices of the ground mesh that project on free pixels next to the target are labelled ground."""
    vertices = sequence.ground[0]
    good = total = 0
    for frame in sequence.scene["frames"][::6]:
        semantic = sequence.labels(frame, "semantic")
        origin = np.array(frame["T_world_object"])[:3, 3]
        near = vertices[np.linalg.norm(vertices - origin, axis=1) < 6.0]
        points = in_camera(near, np.array(frame["T_world_camera"]), np.eye(4))
        image = points @ sequence.k.T
        pixels = np.floor(image[:, :2] / image[:, 2:]).astype(int)
        inside = (points[:, 2] > 0.1) & (pixels >= 0).all(1) & (pixels < semantic.shape[::-1]).all(1)
        found = semantic[pixels[inside, 1], pixels[inside, 0]]
        free = (found == GROUND) | (found == 0)
        total, good = total + free.sum(), good + (found == GROUND).sum()
    report.figures["ground_agreement"] = float(good / max(1, total))
    report.demand(good / max(1, total) > 0.995, "points of the ground mesh are not labelled ground")


def _check_camera(sequence: Sequence, report: Report) -> None:
    """Poses are rigid; the camera moves, and its height over the ground varies unless near-degenerate."""
    frames = sequence.scene["frames"]
    for key in ("T_world_camera", "T_world_object"):
        rotations = np.array([np.array(f[key])[:3, :3] for f in frames])
        error = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max()
        report.demand(
            error < 1e-9 and bool((np.linalg.det(rotations) > 0).all()), f"{key} is not a rotation ({error:.1e})"
        )
    heights = [f["camera_height_over_object_plane"] for f in frames]
    report.figures |= {"camera_height_min_m": min(heights), "camera_height_max_m": max(heights)}
    if not sequence.scene["near_degenerate"] and len(frames) >= 30:
        report.demand(np.ptp(heights) > 2.0, "the camera's height over the ground hardly varies")


def _check_dashcam(sequence: Sequence, report: Report) -> None:
    """A dashcam rides at its height over the road and sees the angle that K says."""
    scene = sequence.scene
    if scene.get("camera") != "dashcam":
        return
    view = float(np.degrees(2 * np.arctan(scene["width"] / 2 / sequence.k[0, 0])))
    good = abs(view - scene["camera_view_deg"]) < 0.01 and DASHCAM_VIEW_DEG[0] <= view <= DASHCAM_VIEW_DEG[1]
    report.demand(bool(good), f"K sees {view:.2f} degrees, scene.json says {scene['camera_view_deg']:.2f}")
    centers = np.array([np.array(f["T_world_camera"])[:3, 3] for f in scene["frames"]])
    heights = centers[:, 2] - _ground_heights(sequence.ground, centers[:, :2])
    report.demand(bool(np.isfinite(heights).all()), "the ground mesh does not reach under the camera")
    heights = heights[np.isfinite(heights)]
    lowest, highest = float(heights.min(initial=np.inf)), float(heights.max(initial=-np.inf))
    report.figures |= {"ride_height_min_m": lowest, "ride_height_max_m": highest} if len(heights) else {}
    inside = DASHCAM_HEIGHT_M[0] < lowest and highest < DASHCAM_HEIGHT_M[1]
    report.demand(inside or not len(heights), f"the camera rides {lowest:.2f} to {highest:.2f} m over the road")


def _check_times(sequence: Sequence, report: Report) -> None:
    """Time stamps rise evenly and are those of the video."""
    times = np.array([f["time_s"] for f in sequence.scene["frames"]])
    video = sequence.folder / "video.mp4"
    command = [
        "ffprobe",
        "-v",
        "error",
        "-select_streams",
        "v:0",
        "-show_entries",
        "packet=pts_time",
        "-of",
        "csv=p=0",
        str(video),
    ]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    stamps = np.sort([float(line.strip(",")) for line in listed])
    report.demand(len(stamps) == len(times), f"the video has {len(stamps)} frames, scene.json {len(times)}")
    if len(stamps) == len(times):
        error = np.abs(stamps - stamps[0] - times).max()
        report.figures["time_error_s"] = float(error)
        report.demand(error < MAX_TIME_ERROR_S, f"time stamps are up to {error:.4f} s off the video's")


CHECKS = (
    _check_masks,
    _check_visibility,
    _check_wheels,
    _check_ground,
    _check_camera,
    _check_dashcam,
    _check_times,
)


def check(folder: Path) -> Report:
    """All checks on one sequence."""
    report = Report(folder.name)
    sequence = load(folder)
    for examine in CHECKS:
        examine(sequence, report)
    size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file() and "images" not in p.parts)
    report.figures["mib"] = size / 2**20
    return report
