"""Truth of real clips and arithmetic on it: camera paths, a GoPro's receiver and sensors, vehicle sizes."""

import re
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
EARTH_M = 6_378_137.0


@dataclass
class Similarity:
    """b = scale · rotation · a + translation, and the residuals of the points."""

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    residuals: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, units of b."""
        return float(np.sqrt((self.residuals**2).sum(1).mean()))


def similarity(a: np.ndarray, b: np.ndarray) -> Similarity:
    """Least squares (Umeyama 1991)."""
    a0, b0 = a - a.mean(0), b - b.mean(0)
    u, d, vt = np.linalg.svd(b0.T @ a0 / len(a))
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = u @ np.diag(sign) @ vt
    scale = float((d * sign).sum() / (a0**2).sum(1).mean())
    translation = b.mean(0) - scale * rotation @ a.mean(0)
    return Similarity(scale, rotation, translation, b - scale * a @ rotation.T - translation)


def length(path: np.ndarray) -> float:
    """Length of a path."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of w, x, y, z."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def mean_rotation(rotations: np.ndarray) -> np.ndarray:
    """Rotation that is nearest to all in the sense of the chordal distance."""
    u, _, vt = np.linalg.svd(rotations.sum(0))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def angles_deg(rotations: np.ndarray) -> np.ndarray:
    """Angles of rotations, degrees."""
    traces = np.trace(rotations, axis1=1, axis2=2)
    return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def read_poses(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (world from camera) and centers of a file with 3x4 matrices, one a line."""
    poses = np.loadtxt(path).reshape(-1, 3, 4)
    return poses[:, :, :3], poses[:, :, 3]


# GPMF, read independently of the program: <https://github.com/gopro/gpmf-parser>.


def telemetry_track(video: Path) -> list[tuple[float, float, bytes]]:
    """Payloads of a video's telemetry track with their beginnings and ends, seconds; none without such a track."""
    probe = ["ffprobe", "-v", "error", "-select_streams", "d", "-show_entries"]
    listed = subprocess.run(
        [*probe, "stream=index,codec_tag_string", "-of", "csv=p=0", str(video)], capture_output=True, text=True
    ).stdout
    index = [line.split(",")[0] for line in listed.splitlines() if "gpmd" in line]
    if not index:
        return []
    entries = [*probe[:3], "-select_streams", index[0], "-show_entries", "packet=pts_time,duration_time,pos,size"]
    packets = subprocess.run([*entries, "-of", "csv=p=0", str(video)], capture_output=True, text=True, check=True)
    content, found = video.read_bytes(), []
    for line in packets.stdout.splitlines():
        start, duration, size, at = line.split(",")[:4]
        found.append((float(start), float(start) + float(duration), content[int(at) : int(at) + int(size)]))
    return found


TYPES = {"b": "b", "B": "B", "s": "h", "S": "H", "l": "i", "L": "I", "f": "f", "d": "d", "j": "q", "J": "Q"}


def entries(data: bytes) -> Iterator[tuple[str, str, int, bytes]]:
    """Key, type, sample size and samples."""
    at = 0
    while at + 8 <= len(data):
        size, count = data[at + 5], int.from_bytes(data[at + 6 : at + 8], "big")
        samples = data[at + 8 : at + 8 + size * count]
        yield data[at : at + 4].decode("latin1"), data[at + 4 : at + 5].decode("latin1"), size, samples
        at += 8 + (size * count + 3) // 4 * 4


def streams(video: Path, *keys: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times (seconds of the video) and scaled samples of streams of one type."""
    rows: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for start, end, payload in telemetry_track(video):
        for _, _, _, device in entries(payload):
            for name, _, _, stream in entries(device):
                if name != "STRM":
                    continue
                scale = np.ones(1)
                for key, kind, size, samples in entries(stream):
                    if key != "SCAL" and key not in keys:
                        continue
                    values = np.frombuffer(samples, np.dtype(TYPES[kind]).newbyteorder(">")).astype(float)
                    if key == "SCAL":
                        scale = values
                    else:
                        table = values.reshape(-1, size // struct.calcsize(TYPES[kind])) / scale
                        times = start + (end - start) * np.arange(len(table)) / max(len(table), 1)
                        rows.setdefault(key, []).append((times, table))
    return {key: (np.concatenate([t for t, _ in p]), np.concatenate([v for _, v in p])) for key, p in rows.items()}


def receiver_path(video: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and positions (m east, north, up of the first) of the receiver in a GoPro's video."""
    found = streams(video, "GPS5").get("GPS5")
    if found is None:
        return None
    times, rows = found
    latitude, longitude = np.radians(rows[:, 0]), np.radians(rows[:, 1])
    east = EARTH_M * np.cos(latitude[0]) * (longitude - longitude[0])
    return times, np.stack([east, EARTH_M * (latitude - latitude[0]), rows[:, 2] - rows[0, 2]], axis=1)


def sensor_rotations(video: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Times, rotations (image from the camera at the start) and directions of gravity in the image."""
    found = streams(video, "CORI", "IORI", "GRAV")
    if len(found) < 3:
        return None
    (times, camera), (_, image), (_, gravity) = found["CORI"], found["IORI"], found["GRAV"]
    turn = np.array([rotation_of(row) for row in image])
    down = np.einsum("nij,nj->ni", turn, gravity / np.linalg.norm(gravity, axis=1, keepdims=True))
    return times, turn @ np.array([rotation_of(row) for row in camera]), down


# Sizes of vehicles by class.


def segments() -> tuple[dict[str, np.ndarray], float]:
    """Of each class rows of share, medians of length, width, height (m) and spreads of their logarithms; correlation.

    Read from the code that uses them, src/metric/vehicles.
    """
    folder = ROOT / "src/metric/vehicles"
    text, numbers = (folder / "segments.rs").read_text(), r"\[([\d., ]+)\]"
    row = [float(x) for x in re.search(rf"const CARS: \[f64; 3\] = {numbers};", text)[1].split(",")]
    cars = re.findall(rf"cars\(([\d.]+), {numbers}\)", text)
    found = {"car": [[float(share), *map(float, medians.split(",")), *row] for share, medians in cars]}
    plain = rf"const (\w+): \[Segment; 1\] = \[Segment {{ share: 1.0, median_m: {numbers}, spread: {numbers} }}\];"
    for name, medians, spread in re.findall(plain, text):
        found[name.lower()] = [[1.0, *map(float, medians.split(",")), *map(float, spread.split(","))]]
    shared = re.search(r"const SHARED_BY_VEHICLE: f64 = ([\d.]+);", (folder / "mod.rs").read_text())[1]
    return {name: np.array(rows) for name, rows in found.items()}, float(shared)


def quantile_of(log_value: float, std: float, weights: np.ndarray, means: np.ndarray, spreads: np.ndarray) -> float:
    """Deviation of a logarithm from a mixture of normal distributions, in standard deviations of a normal one."""
    from statistics import NormalDist

    normal = NormalDist()
    below = sum(w * normal.cdf((log_value - m) / np.hypot(s, std)) for w, m, s in zip(weights, means, spreads))
    return normal.inv_cdf(float(np.clip(below / weights.sum(), 1e-9, 1 - 1e-9)))
