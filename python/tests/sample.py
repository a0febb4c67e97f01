"""A small output folder with all kinds of content, and a writer of PNG files with every filter."""

from __future__ import annotations

import json
import shutil
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

GOLDEN = Path(__file__).parents[2] / "tests" / "golden" / "models"
TURN = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # 90° about z
NAMES = ["left.jpg", "middle.jpg", "right.jpg"]


def estimate(value: float, std: float) -> dict[str, float]:
    return {"value": value, "std": std}


def trajectory_frame(frame: int) -> dict[str, Any]:
    """A frame of a vehicle: 2 m/s along y of the metric frame; the third has no quantities in meters."""
    place = [0.0, 0.1 * frame, 0.0]
    row: dict[str, Any] = {
        "frame": frame,
        "name": NAMES[frame],
        "time_s": 0.5 * frame,
        "position": place,
        "world_from_object": {"scale": 0.5, "rotation_wxyz": TURN, "translation": place},
        "later_key": float(frame),
    }
    if frame < 2:
        row |= {
            "position_m": [-1.0 * frame, 0.0, 1.0],
            "position_std_m": [0.1, 0.2, 0.3],
            "smoothed_position_m": [-1.0 * frame, 0.0, 1.0],
            "speed_m_s": 2.0,
            "speed_std_m_s": 0.25,
            "heading_deg": None,
            "longitude": 8.0 + 1e-5 * frame,
            "latitude": 49.0,
            "height_m": 100.0,
            "place_std_m": [0.3, 0.4, 1.0],
        }
    return row


def vehicle(number: int, state: str | None) -> dict[str, Any]:
    verdict = {
        "state": state,
        "reasons": [{"kind": "ground", "finding": "supports", "says": "stands on the ground", "weight": 0.0}],
    }
    return {
        "id": number,
        "class": "car",
        "confidence": 0.9,
        "scale": {"ratio": 0.5, "std": 0.01, "method": "joint", "degenerate": False, "reason": None, "later_key": 1},
        "verdict": verdict if state else None,
        "dimensions": {"length_m": estimate(4.5, 0.1), "width_m": None, "height_m": estimate(1.5, 0.1)},
        "travel": {"path_units": estimate(0.2, 0.01), "path_m": estimate(2.0, 0.1)},
        "frames": [trajectory_frame(frame) for frame in range(3)],
        "later_key": "kept",
    }


def ground_track(number: int) -> dict[str, Any]:
    error = {"noise": np.diag([1.0, 2.0, 3.0]).tolist(), "drift": [1.0, 0.0, 0.0], "common": [0.0, 2.0, 0.0]}
    return {
        "id": number,
        "class": "truck",
        "confidence": 0.4,
        "method": "ground-contact",
        "reason": "no trajectory: too small",
        "verdict": {"state": "usable", "distance_std": 0.04, "says": "distance to the camera ±4 %"},
        "omitted": {"truncated": 2, "near-horizon": 1},
        "travel": {"path_units": estimate(0.2, 0.01)},
        "frames": [
            {
                "frame": 1,
                "name": NAMES[1],
                "time_s": 0.5,
                "position": [1, 2, 3],
                "error": error,
                "position_m": [1, 2, 0],
            }
        ],
    }


def trajectories() -> dict[str, Any]:
    """Content of trajectories.json. Meters are ten units, turned by 90° about z, one up."""
    metric = {
        "verdict": "telemetry",
        "reason": "scale from telemetry",
        "scale": 10.0,
        "rotation_wxyz": TURN,
        "translation": [0.0, 0.0, 1.0],
        "axes": "east-north-up",
        "origin": {"longitude": 8.0, "latitude": 49.0, "height_m": 100.0, "knows_height": True},
        "std": {"scale": 0.2, "tilt_deg": 0.5, "heading_deg": 1.0, "place_m": None},
    }
    return {
        "version": 3,
        "unit": "background",
        "metric": metric,
        "objects": [vehicle(1, "good"), vehicle(4, "rejected"), vehicle(5, None)],
        "ground_tracks": [ground_track(4)],
        "later_key": [1, 2],
    }


def write_png(path: Path, image: np.ndarray) -> None:
    """Write 8-bit gray; row i has filter i mod 5."""
    height, width = image.shape
    padded = np.zeros((height + 1, width + 1), int)
    padded[1:, 1:] = image
    rows = []
    for y in range(height):
        left, up, corner = padded[y + 1, :-1], padded[y, 1:], padded[y, :-1]
        paeth = []
        for a, b, c in zip(left, up, corner):
            distances = [abs(b - c), abs(a - c), abs(a + b - 2 * c)]
            paeth.append((a, b, c)[distances.index(min(distances))])
        predicted = [np.zeros(width, int), left, up, (left + up) // 2, np.array(paeth)][y % 5]
        rows.append(bytes([y % 5]) + (image[y].astype(int) - predicted).astype(np.uint8).tobytes())

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(b"".join(rows))) + chunk(b"IEND", b"")
    )


def mask_image() -> np.ndarray:
    return np.where(np.random.default_rng(0).random((11, 17)) < 0.4, 255, 0).astype(np.uint8)


def write_output(folder: Path) -> None:
    """Write an output folder whose models are those of tests/golden."""
    folder.mkdir(parents=True)
    (folder / "trajectories.json").write_text(json.dumps(trajectories()))
    (folder / "run.json").write_text(json.dumps({"version": "0.1.0", "warnings": []}))
    (folder / "tracks.json").write_text(json.dumps({"version": 1, "objects": [{"id": 1}, {"id": 7}]}))
    shutil.copytree(GOLDEN / "colmap_text", folder / "background")
    shutil.copytree(GOLDEN / "colmap_binary", folder / "objects" / "1")
    (folder / "tracks" / "1").mkdir(parents=True)
    write_png(folder / "tracks" / "1" / f"{NAMES[1]}.png", mask_image())
    head = "ply\nformat {}\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    body = struct.pack("<3d3B3d3B", 1, 2, 3, 10, 20, 30, 4, 5, 6, 40, 50, 60)
    (folder / "ply").mkdir()
    (folder / "ply" / "background.ply").write_bytes(head.format("binary_little_endian 1.0").encode() + body)
    ascii_body = "1 2 3 10 20 30\n4 5 6 40 50 60\n"
    (folder / "ply" / "object-1.ply").write_text(head.format("ascii 1.0") + ascii_body)
