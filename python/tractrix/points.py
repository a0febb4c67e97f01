"""Point clouds: PLY files, text and binary."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ._json import RERUN, read_bytes
from .errors import DamagedError
from .geometry import Floats

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Colored points.

    Attributes:
        xyz: positions, shape (N, 3), in the frame and unit of the file.
        rgb: colors, shape (N, 3), 0 to 255; white where the file has none.
    """

    xyz: Floats
    rgb: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.xyz)


def read_ply(path: Path | str) -> PointCloud:
    """Read the vertices of a PLY file."""
    path = Path(path)
    data = read_bytes(path)
    try:
        table = _vertices(data)
        xyz = np.stack([table[axis].astype(float) for axis in "xyz"], axis=1)
        colors = ("red", "green", "blue")
        if all(color in (table.dtype.names or ()) for color in colors):
            rgb = np.stack([table[color].astype(np.uint8) for color in colors], axis=1)
        else:
            rgb = np.full(xyz.shape, 255, np.uint8)
    except (ValueError, KeyError, IndexError, OverflowError):
        raise DamagedError(path, "not a complete PLY file", RERUN) from None
    return PointCloud(xyz, rgb)


def _vertices(data: bytes) -> npt.NDArray[np.void]:
    head, mark, body = data.partition(b"end_header")
    lines = [line.split() for line in head.decode("ascii").splitlines()]
    if lines[0] != ["ply"] or not mark:
        raise ValueError
    body = body.split(b"\n", 1)[1]
    kind = next(words[1] for words in lines if words[:1] == ["format"])
    elements = [i for i, words in enumerate(lines) if words[:1] == ["element"]]
    first = elements[0]
    if lines[first][1] != "vertex":
        raise ValueError
    count = int(lines[first][2])
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = [words for words in lines[first:end] if words[:1] == ["property"]]
    dtype = np.dtype([(words[-1], ORDERS[kind] + TYPES[words[1]]) for words in properties])
    if kind != "ascii":
        return np.frombuffer(body, dtype, count)
    rows = body.decode("ascii").split("\n")[:count]
    table = np.array([tuple(float(word) for word in row.split()) for row in rows], dtype=dtype)
    if len(table) != count:
        raise ValueError
    return table
