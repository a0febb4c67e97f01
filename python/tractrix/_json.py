"""Checked access to JSON: every reader names the file and the key at fault."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from .errors import DamagedError, MissingError

RERUN = "copy the folder again, or repeat the command that wrote it"


def read_bytes(path: Path) -> bytes:
    """Read a file of an output folder."""
    try:
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise MissingError(path, "no such file", "give the output folder of a completed `tractrix run`") from None
    except OSError as error:
        raise MissingError(path, f"not readable ({error.strerror})", "check the permissions and the disk") from error


def read_text(path: Path) -> str:
    """Read a UTF-8 file of an output folder."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError:
        raise DamagedError(path, "not UTF-8", RERUN) from None


class Node:
    """An object of a JSON file and its location, for messages."""

    def __init__(self, path: Path, value: Mapping[str, Any], place: str = "") -> None:
        self.path, self.value, self.place = path, value, place

    @classmethod
    def read(cls, path: Path) -> Node:
        """Read a file whose content is a JSON object."""
        try:
            value = json.loads(read_text(path))
        except (ValueError, RecursionError):
            raise DamagedError(path, "not JSON, or truncated", RERUN) from None
        if not isinstance(value, dict):
            raise DamagedError(path, "not a JSON object", RERUN)
        return cls(path, value)

    def fail(self, key: str, expected: str) -> NoReturn:
        raise DamagedError(self.path, f"`{self.place}{key}` is not {expected}", RERUN)

    def get(self, key: str) -> Any:
        return self.value.get(key)

    def text(self, key: str, default: str | None = None) -> str:
        value = self.value.get(key, default)
        return value if isinstance(value, str) else self.fail(key, "a text")

    def integer(self, key: str) -> int:
        value = self.value.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 53:
            self.fail(key, "a count")
        return value

    def boolean(self, key: str) -> bool:
        value = self.value.get(key)
        return value if isinstance(value, bool) else self.fail(key, "true or false")

    def number(self, key: str) -> float:
        return self._number(key, self.value.get(key))

    def number_or_none(self, key: str) -> float | None:
        value = self.value.get(key)
        return None if value is None else self._number(key, value)

    def _number(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.fail(key, "a finite number")
        return float(value)

    def vector(self, key: str, length: int) -> list[float]:
        value = self.value.get(key)
        if not isinstance(value, list) or len(value) != length:
            self.fail(key, f"a list of {length} numbers")
        return [self._number(key, element) for element in value]

    def vector_or_none(self, key: str, length: int) -> list[float] | None:
        return None if self.value.get(key) is None else self.vector(key, length)

    def matrix(self, key: str, side: int) -> list[list[float]]:
        value = self.value.get(key)
        if not isinstance(value, list) or len(value) != side:
            self.fail(key, f"a {side} × {side} matrix")
        rows = Node(self.path, {str(i): row for i, row in enumerate(value)}, f"{self.place}{key}.")
        return [rows.vector(str(i), side) for i in range(side)]

    def node(self, key: str) -> Node:
        value = self.value.get(key)
        if not isinstance(value, dict):
            self.fail(key, "an object")
        return Node(self.path, value, f"{self.place}{key}.")

    def node_or_none(self, key: str) -> Node | None:
        return None if self.value.get(key) is None else self.node(key)

    def nodes(self, key: str, default: Sequence[Any] | None = None) -> list[Node]:
        values = self.value.get(key, default)
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            self.fail(key, "a list of objects")
        return [Node(self.path, value, f"{self.place}{key}[{i}].") for i, value in enumerate(values)]
