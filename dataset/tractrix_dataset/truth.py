"""Ground truth files: scene.json, the vehicle's mesh, the ground's mesh."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from . import labels
from .blender import decimated
from .drives import FPS, Dashcam
from .ground import crop
from .kinematics import Motion
from .mesh import read_ply, write_ply, write_ply_ascii
from .outline import in_camera, visible_share, whole_pixels
from .render import RenderOptions
from .scene import Parked, World
from .vehicles.assemble import ground_truth_mesh

GROUND_REACH_M = 14.0
MAX_GROUND_TRIANGLES = 18000

CONVENTIONS = (
    "World: right-handed, z up, metres. Camera: x right, y down, z forward. T_world_camera maps homogeneous camera to "
    "world points; T_world_object maps object_mesh.ply vertices to world. Object axes: x forward, y left, z up, origin "
    "on the ground below the middle of the wheelbase. Wheels in the render spin, steer and follow the ground (at most "
    "7 cm); the mesh holds them at rest. ground_mesh.ply: the ground round the drive as rendered, world coordinates."
)
MASKS = (
    "masks/NNNNN.png (8 bit): 0 background, 1 target vehicle, 2 other moving vehicle. semantic/NNNNN.png: 0 sky, "
    "1 target, 2 other moving vehicle, 3 ground (street, sidewalk, grass), 4 other static. One label per pixel, "
    "occlusion-aware, from the object index of the pixel's first sample, 3x3 median at the target's outline. "
    "visible_share: the target's pixels over those of its whole silhouette, beyond the picture's edges too."
)


def _rows(matrix: np.ndarray) -> list[list[float]]:
    return [[float(v) for v in row] for row in matrix]


def _shown(world: World, options: RenderOptions, folder: Path, index: int) -> float:
    """Share of the target's whole silhouette that a frame's mask holds."""
    mask = cv2.imread(str(folder / "masks" / f"{index:05d}.png"), cv2.IMREAD_GRAYSCALE)
    vertices, triangles = read_ply(folder / "object_mesh.ply")
    camera, pose = world.camera.world_from_camera[index], world.motion.world_from_object[index]
    k = world.camera.intrinsics(options.width, options.height)
    whole = whole_pixels(in_camera(vertices, camera, pose), triangles, k, mask.shape)
    return visible_share(int((mask == labels.TARGET).sum()), whole)


def _frame(world: World, options: RenderOptions, folder: Path, index: int) -> dict:
    """The entry of one frame."""
    stem = f"{index:05d}"
    pose, camera = world.motion.world_from_object[index], world.camera.world_from_camera[index]
    return {
        "index": index,
        "image": f"images/{stem}.jpg",
        "video_frame": index,
        "mask": f"masks/{stem}.png",
        "semantic": f"semantic/{stem}.png",
        "time_s": float(world.times[index]),
        "T_world_camera": _rows(camera),
        "T_world_object": _rows(pose),
        "T_world_others": [_rows(motion.world_from_object[index]) for _, motion in world.others],
        "camera_height_over_object_plane": float((camera[:3, 3] - pose[:3, 3]) @ pose[:3, 2]),
        "speed_m_s": _speed(world.motion, world.times, index),
        "visible_share": round(_shown(world, options, folder, index), 4),
    }


def _speed(motion: Motion, times: np.ndarray, index: int) -> float:
    """Speed along the curve (m/s), by central differences."""
    return float(np.gradient(motion.distance, times)[index])


def _camera_entries(world: World) -> dict:
    """What kind of camera it is."""
    carried = world.trajectory.flight
    if not isinstance(carried, Dashcam):
        return {"camera": "drone"}
    return {
        "camera": "dashcam",
        "camera_height_m": carried.height,
        "camera_view_deg": carried.view,
        "camera_pitch_deg": carried.pitch,
        "springs": {"sway_deg": carried.sway, "heave_m": carried.heave},
    }


def scene_json(world: World, options: RenderOptions, device: str, folder: Path) -> dict:
    """The content of scene.json; reads the masks and the mesh in ``folder``."""
    request = world.request
    return {
        "name": request.name,
        "units": "metre",
        "fps": FPS,
        "n_frames": request.n_frames,
        "width": options.width,
        "height": options.height,
        "vehicle": request.vehicle,
        "trajectory": request.trajectory,
        "seed": request.seed,
        "terrain": world.trajectory.terrain,
        "near_degenerate": world.trajectory.near_degenerate,
        **_camera_entries(world),
        "asphalt": world.trajectory.asphalt,
        "target_always_in_picture": world.trajectory.watched,
        "K": _rows(world.camera.intrinsics(options.width, options.height)),
        "K_note": "Pixels; the centre of the upper left pixel is (0.5, 0.5). Square pixels, no distortion, no rolling "
        "shutter, no motion blur.",
        "conventions": CONVENTIONS,
        "masks": MASKS,
        "video": "video.mp4",
        "video_note": "Frame k of the video is the frame with video_frame k; images/ may be left out.",
        "object_mesh": "object_mesh.ply",
        "ground_mesh": "ground_mesh.ply",
        "samples": options.samples,
        "engine": f"Cycles ({device}) with OpenImageDenoise",
        "path_length_m": float(world.motion.distance[-1] - world.motion.distance[0]),
        "others": [vehicle.spec.name for vehicle, _ in world.others],
        "parked": [_parked(car) for car in world.parked],
        "frames": [_frame(world, options, folder, i) for i in range(request.n_frames)],
    }


def _parked(car: Parked) -> dict:
    spec = car.spec
    middle = car.world_from_object @ [0.5 * (spec.nose_x + spec.tail_x), 0.0, 0.0, 1.0]
    forward = car.world_from_object[:2, 0]
    return {
        "model": spec.name,
        "position": middle[:3].tolist(),
        "heading_rad": float(np.arctan2(forward[1], forward[0])),
        "size_m": [spec.length, spec.width, spec.height],
    }


def write_meshes(world: World, folder: Path) -> None:
    """Writes object_mesh.ply (text) and ground_mesh.ply (binary)."""
    vertices, triangles = ground_truth_mesh(world.target)
    write_ply_ascii(
        folder / "object_mesh.ply", vertices, triangles, f"{world.request.vehicle}, metres, object coordinates"
    )
    pieces = [crop(ground, world.focus, GROUND_REACH_M) for ground in world.grounds]
    offsets = np.cumsum([0] + [len(v) for v, _ in pieces[:-1]])
    vertices = np.vstack([v for v, _ in pieces])
    triangles = np.vstack([t + o for (_, t), o in zip(pieces, offsets)])
    vertices, triangles = decimated(vertices, triangles, MAX_GROUND_TRIANGLES)
    write_ply(folder / "ground_mesh.ply", vertices, triangles, "ground round the drive, metres, world coordinates")


def write_json(path: Path, content: dict) -> None:
    """Writes JSON, whole or not at all."""
    partial = path.with_suffix(".partial.json")
    partial.write_text(json.dumps(content, separators=(",", ":")).replace('{"index"', '\n{"index"') + "\n")
    partial.replace(path)
