"""Masks: PNG files of 8-bit gray, 255 = vehicle, 0 = not."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ._json import RERUN, read_bytes
from .errors import DamagedError, MissingError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MAX_PIXELS = 1 << 28  # more than any camera has; a damaged header must not allocate without limit
Mask = npt.NDArray[np.bool_]


class Masks(Mapping[str, Mask]):
    """Masks of one vehicle by image name (`000042.jpg`); files are read on access.

    A value is a boolean array of shape (height, width) at the size of the run. Images in which the vehicle is not
    visible are not among the keys.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._names = sorted(path.name.removesuffix(".png") for path in folder.glob("*.png"))

    def __getitem__(self, name: str) -> Mask:
        if name not in self._names:
            raise KeyError(name)
        return read_mask(self.folder / f"{name}.png")

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def read_mask(path: Path | str) -> Mask:
    """Read a mask as a boolean array of shape (height, width); true on the vehicle."""
    path = Path(path)
    data = read_bytes(path)
    try:
        return _decode(data) > 127
    except _UnsupportedError as kind:
        raise DamagedError(path, f"a PNG of another kind ({kind})", "read it with an image library") from None
    except (struct.error, zlib.error, ValueError, IndexError):
        raise DamagedError(path, "not a complete PNG", RERUN) from None


class _UnsupportedError(Exception):
    pass


def _decode(data: bytes) -> npt.NDArray[np.uint8]:
    if not data.startswith(SIGNATURE):
        raise ValueError
    at, header, stream = len(SIGNATURE), b"", b""
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        chunk = data[at + 8 : at + 8 + length]
        (expected,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(kind + chunk) != expected:
            raise ValueError
        if kind == b"IHDR":
            header = chunk
        elif kind == b"IDAT":
            stream += chunk
        elif kind == b"IEND":
            break
        at += 12 + length
    width, height, depth, color, _, _, interlace = struct.unpack(">IIBBBBB", header)
    if (depth, color, interlace) != (8, 0, 0):
        raise _UnsupportedError(f"{depth} bits, color type {color}, interlace {interlace}")
    if not 0 < width * height <= MAX_PIXELS:
        raise ValueError
    size = height * (width + 1)
    raw = np.frombuffer(zlib.decompressobj().decompress(stream, size), np.uint8)
    rows = raw.reshape(height, width + 1)
    image = np.empty((height, width), np.uint8)
    above = np.zeros(width, np.uint8)
    for row, out in zip(rows, image):
        out[:] = above = _unfilter(int(row[0]), row[1:], above)
    return image


def _unfilter(kind: int, row: npt.NDArray[np.uint8], above: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Undo the filter of a row of one byte per pixel."""
    if kind == 0:
        return row
    if kind == 1:
        return np.cumsum(row, dtype=np.uint8)
    if kind == 2:
        return row + above
    if kind not in (3, 4):
        raise ValueError
    out, left, corner = bytearray(len(row)), 0, 0
    for i, (value, up) in enumerate(zip(row.tolist(), above.tolist())):
        predicted = (left + up) // 2 if kind == 3 else _paeth(left, up, corner)
        left = out[i] = (value + predicted) & 255
        corner = up
    return np.frombuffer(bytes(out), np.uint8)


def _paeth(left: int, up: int, corner: int) -> int:
    to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
    if to_left <= to_up and to_left <= to_corner:
        return left
    return up if to_up <= to_corner else corner


def masks_of(folder: Path, vehicle: int) -> Masks:
    """Masks in `tracks/<vehicle>/` of an output folder."""
    found = folder / "tracks" / str(vehicle)
    if not found.is_dir():
        raise MissingError(f"vehicle {vehicle}", f"no masks in {found}", "give an id from `results.masks`")
    return Masks(found)
