"""COLMAP models, text and binary, with the names of pycolmap."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ._json import RERUN, read_bytes, read_text
from .errors import DamagedError, MissingError
from .geometry import Floats, Sim3

# Camera models by COLMAP's number: name and number of parameters.
MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5), 14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}  # fmt: skip
NUM_PARAMS = dict(MODELS.values())
# Indices, as fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, into the parameters of the models that are projected.
OPENCV_TERMS = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2),
    "PINHOLE": (0, 1, 2, 3),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7),
    "FULL_OPENCV": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11),
}
Part = TypeVar("Part")
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics of a camera. Pixels count from the image corner: the center of the first is (0.5, 0.5).

    Attributes:
        camera_id: id in the model.
        model: COLMAP's name, such as `SIMPLE_RADIAL`.
        width, height: image size, pixels.
        params: parameters in COLMAP's order.
    """

    camera_id: int
    model: str
    width: int
    height: int
    params: Floats

    def _terms(self) -> Floats:
        if self.model not in OPENCV_TERMS:
            subject = f"camera {self.camera_id}"
            raise MissingError(subject, f"no projection for the model {self.model}", "use pycolmap for this camera")
        indices = OPENCV_TERMS[self.model]
        return np.concatenate([self.params[list(indices)], np.zeros(12 - len(indices))])

    def calibration_matrix(self) -> Floats:
        """The matrix K, shape (3, 3), pixels."""
        fx, fy, cx, cy = self._terms()[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def img_from_cam(self, points: npt.ArrayLike) -> Floats:
        """Project points of the camera frame (x right, y down, z forward), shape (..., 3), to pixels, shape (..., 2).

        Points that are not in front of the camera give NaN.
        """
        fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = self._terms()
        points = np.asarray(points, dtype=float)
        depth = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        x, y = points[..., 0] / depth, points[..., 1] / depth
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
        return np.stack([fx * u + cx, fy * v + cy], axis=-1)


@dataclass(frozen=True, eq=False)
class Image:
    """A registered image.

    Attributes:
        image_id: id in the model; in output folders frame + 1.
        camera_id: its camera.
        name: name of the image file.
        cam_from_world: pose; its scale is 1.
        points2D: observed image points, shape (K, 2), pixels.
        point3D_ids: id of each one's 3D point, shape (K,); −1 without.
    """

    image_id: int
    camera_id: int
    name: str
    cam_from_world: Sim3
    points2D: Floats  # noqa: N815
    point3D_ids: Ints  # noqa: N815

    @property
    def frame(self) -> int:
        """Frame id: index of the image in the source, from 0."""
        return self.image_id - 1

    def projection_center(self) -> Floats:
        """Camera center in the world, shape (3,)."""
        return self.cam_from_world.inverse().translation

    def viewing_direction(self) -> Floats:
        """Unit vector in the world along the optical axis, shape (3,)."""
        direction: Floats = self.cam_from_world.rotation[2]
        return direction


@dataclass(frozen=True, eq=False)
class Points3D:
    """Points of a model, as arrays of equal length N.

    Attributes:
        ids: shape (N,).
        xyz: positions, shape (N, 3), in units of the model.
        rgb: colors, shape (N, 3), 0 to 255.
        error: mean reprojection error, shape (N,), pixels.
        tracks: per point, observations of shape (K, 2): image id, index into `points2D`.
    """

    ids: Ints
    xyz: Floats
    rgb: npt.NDArray[np.uint8]
    error: Floats
    tracks: list[Ints]

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A COLMAP model: cameras and images by id, points as arrays."""

    path: Path
    cameras: dict[int, Camera]
    images: dict[int, Image]
    points3D: Points3D  # noqa: N815
    _by_name: dict[str, Image] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_by_name", {image.name: image for image in self.images.values()})
        for image in self.images.values():
            if image.camera_id not in self.cameras:
                problem = f"image {image.image_id} has the unknown camera {image.camera_id}"
                raise DamagedError(self.path, problem, RERUN)

    def find_image_with_name(self, name: str) -> Image | None:
        return self._by_name.get(name)

    def image_of_frame(self, frame: int) -> Image:
        """Registered image of a frame."""
        if frame + 1 not in self.images:
            raise MissingError(f"frame {frame}", f"no camera pose in {self.path}", "take a frame of `images`")
        return self.images[frame + 1]

    def camera_of(self, image: Image) -> Camera:
        return self.cameras[image.camera_id]

    def project(self, points: npt.ArrayLike, image: Image) -> Floats:
        """Project points of the world, shape (..., 3), into an image: pixels, shape (..., 2)."""
        return self.camera_of(image).img_from_cam(image.cam_from_world * points)


def read_reconstruction(folder: Path | str) -> Reconstruction:
    """Read a folder with a COLMAP model; with both forms the binary one, as COLMAP does."""
    folder = Path(folder)
    binary = (folder / "cameras.bin").is_file()
    if not binary and not (folder / "cameras.txt").is_file():
        raise MissingError(folder, "no COLMAP model (cameras.bin or cameras.txt)", "give a folder with a model")
    cameras, images, points = BINARY if binary else TEXT
    ending = ".bin" if binary else ".txt"
    return Reconstruction(
        folder,
        _read(folder / f"cameras{ending}", cameras),
        _read(folder / f"images{ending}", images),
        _read(folder / f"points3D{ending}", points),
    )


def _read(path: Path, reader: Callable[[Path], Part]) -> Part:
    try:
        return reader(path)
    except (ValueError, KeyError, IndexError, OverflowError, struct.error):
        raise DamagedError(path, "not a complete file of a COLMAP model", RERUN) from None


def _camera(camera_id: int, model: str, width: int, height: int, params: Floats) -> Camera:
    if len(params) != NUM_PARAMS[model]:
        raise ValueError
    return Camera(camera_id, model, width, height, params)


def _points(rows: list[tuple[int, list[float], list[int], float, Ints]]) -> Points3D:
    ids, xyz, rgb, errors, tracks = zip(*rows) if rows else ((), (), (), (), ())
    return Points3D(
        np.array(ids, np.int64),
        np.array(xyz, float).reshape(-1, 3),
        np.array(rgb, np.uint8).reshape(-1, 3),
        np.array(errors, float),
        list(tracks),
    )


def _text_lines(path: Path) -> list[str]:
    return [line for line in read_text(path).split("\n") if not line.startswith("#")]


def _text_cameras(path: Path) -> dict[int, Camera]:
    rows = [line.split() for line in _text_lines(path) if line.strip()]
    cameras = [_camera(int(r[0]), r[1], int(r[2]), int(r[3]), np.array(r[4:], float)) for r in rows]
    return {camera.camera_id: camera for camera in cameras}


def _text_images(path: Path) -> dict[int, Image]:
    lines, images, at = _text_lines(path), {}, 0
    while at < len(lines):
        if not lines[at].strip():
            at += 1
            continue
        words = lines[at].split(maxsplit=9)
        image_id, camera_id, name = int(words[0]), int(words[8]), words[9].rstrip("\r")
        pose = Sim3.from_wxyz(1.0, [float(w) for w in words[1:5]], [float(w) for w in words[5:8]])
        observed = np.array(lines[at + 1].split(), float).reshape(-1, 3)
        images[image_id] = Image(
            image_id, camera_id, name, pose, observed[:, :2], observed[:, 2].astype(np.int64)
        )  # fmt: skip
        at += 2
    return images


def _text_points(path: Path) -> Points3D:
    rows = []
    for words in (line.split() for line in _text_lines(path) if line.strip()):
        track = np.array(words[8:], np.int64).reshape(-1, 2)
        rows.append(
            (int(words[0]), [float(w) for w in words[1:4]], [int(w) for w in words[4:7]], float(words[7]), track)
        )
    return _points(rows)


class _Cursor:
    """Position in a little-endian binary file."""

    def __init__(self, path: Path) -> None:
        self.data, self.at = read_bytes(path), 0

    def take(self, layout: str) -> tuple[int, ...]:
        values = struct.unpack_from("<" + layout, self.data, self.at)
        self.at += struct.calcsize("<" + layout)
        return values

    def floats(self, count: int) -> list[float]:
        return [float(value) for value in self.take(f"{count}d")]

    def array(self, dtype: npt.DTypeLike, count: int) -> npt.NDArray[np.void]:
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += values.nbytes
        return values

    def name(self) -> str:
        end = self.data.index(b"\0", self.at)
        name = self.data[self.at : end].decode()
        self.at = end + 1
        return name


def _binary_cameras(path: Path) -> dict[int, Camera]:
    cursor, cameras = _Cursor(path), {}
    for _ in range(cursor.take("Q")[0]):
        camera_id, number, width, height = cursor.take("IiQQ")
        model, count = MODELS[number]
        cameras[camera_id] = _camera(camera_id, model, width, height, np.array(cursor.floats(count)))
    return cameras


def _binary_images(path: Path) -> dict[int, Image]:
    cursor, images = _Cursor(path), {}
    layout = np.dtype([("xy", "<f8", 2), ("id", "<i8")])
    for _ in range(cursor.take("Q")[0]):
        (image_id,) = cursor.take("I")
        pose = Sim3.from_wxyz(1.0, cursor.floats(4), cursor.floats(3))
        (camera_id,) = cursor.take("I")
        name = cursor.name()
        observed = cursor.array(layout, cursor.take("Q")[0])
        images[image_id] = Image(image_id, camera_id, name, pose, observed["xy"].copy(), observed["id"].copy())
    return images


def _binary_points(path: Path) -> Points3D:
    cursor, rows = _Cursor(path), []
    for _ in range(cursor.take("Q")[0]):
        (point_id,) = cursor.take("Q")
        xyz, rgb = cursor.floats(3), list(cursor.take("BBB"))
        (error,) = cursor.floats(1)
        (length,) = cursor.take("Q")
        track = cursor.array(np.dtype(("<i4", 2)), length).astype(np.int64).reshape(-1, 2)
        rows.append((point_id, xyz, rgb, error, track))
    return _points(rows)


TEXT = (_text_cameras, _text_images, _text_points)
BINARY = (_binary_cameras, _binary_images, _binary_points)
