"""Plane curves of straight lines and arcs: street centre lines and drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SAMPLE_STEP_M = 0.25


@dataclass(frozen=True)
class Line:
    """A straight piece from ``start`` to ``end`` (2-vectors, metres)."""

    start: np.ndarray
    end: np.ndarray

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    def locate(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the piece, and arc length of the nearest point on it."""
        tangent = (self.end - self.start) / self.length
        along = (x - self.start[0]) * tangent[0] + (y - self.start[1]) * tangent[1]
        along = np.clip(along, 0, self.length)
        return np.hypot(x - self.start[0] - along * tangent[0], y - self.start[1] - along * tangent[1]), along

    def point(self, s: np.ndarray) -> np.ndarray:
        """Points (N, 2) at arc lengths ``s``."""
        return self.start + (self.end - self.start) * (np.asarray(s) / self.length)[:, None]


@dataclass(frozen=True)
class Arc:
    """A circular piece; ``sweep`` is signed (left turns are positive), radians."""

    center: np.ndarray
    radius: float
    start_angle: float
    sweep: float

    @property
    def length(self) -> float:
        return abs(self.sweep) * self.radius

    def locate(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As :meth:`Line.locate`."""
        sign = np.sign(self.sweep)
        turned = (np.arctan2(y - self.center[1], x - self.center[0]) - self.start_angle) * sign
        turned = np.mod(turned + np.pi - abs(self.sweep) / 2, 2 * np.pi) - np.pi + abs(self.sweep) / 2
        turned = np.clip(turned, 0, abs(self.sweep))
        angle = self.start_angle + sign * turned
        nearest_x = self.center[0] + self.radius * np.cos(angle)
        nearest_y = self.center[1] + self.radius * np.sin(angle)
        return np.hypot(x - nearest_x, y - nearest_y), turned * self.radius

    def point(self, s: np.ndarray) -> np.ndarray:
        """Points (N, 2) at arc lengths ``s``."""
        angle = self.start_angle + np.sign(self.sweep) * np.asarray(s) / self.radius
        return self.center + self.radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def _fillet(before: np.ndarray, corner: np.ndarray, after: np.ndarray, radius: float) -> tuple:
    """The arc that rounds a corner, with the points where it begins and ends."""
    into = (corner - before) / np.linalg.norm(corner - before)
    out = (after - corner) / np.linalg.norm(after - corner)
    turn = np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out)
    cut = radius * np.tan(abs(turn) / 2)
    begin, end = corner - cut * into, corner + cut * out
    normal = np.sign(turn) * np.array([-into[1], into[0]])
    center = begin + radius * normal
    start_angle = np.arctan2(begin[1] - center[1], begin[0] - center[0])
    return Arc(center, radius, start_angle, turn), begin, end


class Path:
    """A chain of lines and arcs through way points ``(x, y, fillet radius)``."""

    def __init__(self, waypoints: list[tuple[float, float, float]], closed: bool = False) -> None:
        points = [np.array(w[:2], float) for w in waypoints]
        n = len(points)
        corners = range(n) if closed else range(1, n - 1)
        arcs = {i: _fillet(points[i - 1], points[i], points[(i + 1) % n], waypoints[i][2]) for i in corners}
        self.pieces: list[Line | Arc] = []
        for i in range(n if closed else n - 1):
            j = (i + 1) % n
            start = arcs[i][2] if i in arcs else points[i]
            end = arcs[j][1] if j in arcs else points[j]
            self.pieces.append(Line(start, end))
            if j in arcs:
                self.pieces.append(arcs[j][0])
        self.starts = np.concatenate([[0.0], np.cumsum([p.length for p in self.pieces])])
        self.length = float(self.starts[-1])
        self.closed = closed
        samples = self.point(np.arange(0.0, self.length, 1.0))
        self.bounds = (samples.min(0) - 1.0, samples.max(0) + 1.0)

    def locate(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the path (m) and arc length (m) of the nearest point."""
        best = np.full(np.shape(x), np.inf)
        along = np.zeros(np.shape(x))
        for piece, start in zip(self.pieces, self.starts):
            distance, s = piece.locate(x, y)
            closer = distance < best
            best = np.where(closer, distance, best)
            along = np.where(closer, s + start, along)
        return best, along

    def point(self, s: np.ndarray) -> np.ndarray:
        """Points (N, 2) at arc lengths; closed paths wrap round, open ones go on straight."""
        s = np.atleast_1d(np.asarray(s, float))
        wrapped = np.mod(s, self.length) if self.closed else np.clip(s, 0, self.length - 1e-9)
        index = np.clip(np.searchsorted(self.starts, wrapped, side="right") - 1, 0, len(self.pieces) - 1)
        result = np.zeros((len(s), 2))
        for k in np.unique(index):
            chosen = index == k
            result[chosen] = self.pieces[k].point(wrapped[chosen] - self.starts[k])
        if not self.closed:
            result += self._overshoot(s)
        return result

    def _overshoot(self, s: np.ndarray) -> np.ndarray:
        """What is to be added beyond the ends of an open path."""
        first, last = self.pieces[0], self.pieces[-1]
        ahead = np.diff(last.point(np.array([last.length - 0.01, last.length])), axis=0)[0] / 0.01
        behind = np.diff(first.point(np.array([0.0, 0.01])), axis=0)[0] / 0.01
        return np.maximum(s - self.length, 0)[:, None] * ahead + np.minimum(s, 0)[:, None] * behind

    def tangent(self, s: np.ndarray) -> np.ndarray:
        """Unit tangents (N, 2) at arc lengths, averaged over 10 cm."""
        s = np.atleast_1d(np.asarray(s, float))
        difference = self.point(s + 0.05) - self.point(s - 0.05)
        return difference / np.linalg.norm(difference, axis=1, keepdims=True)

    def offset_point(self, s: np.ndarray, lateral_m: np.ndarray | float) -> np.ndarray:
        """Points (N, 2) ``lateral_m`` to the left of the path at arc lengths ``s``."""
        tangent = self.tangent(s)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], 1)
        return self.point(s) + normal * np.broadcast_to(lateral_m, len(tangent))[:, None]
