#!/usr/bin/env python3
"""Writes a video of a made-up flight of any length over ground that never repeats: what a long video costs.

    scripts/benchmark/flight.py FRAMES VIDEO.mp4

480×270, 10 frames a second, f = 440 px: a camera 25 m above a road, 4 m/s, looking 35° down, over noise on the ground
and on boxes beside the road. Every seven seconds a box with dark panes drives by: oncoming, overtaking or overtaken.
Quick and plain (flat shades, no shadows): for time and memory, not for accuracy. Needs numpy, OpenCV and ffmpeg.
"""

import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

Array = np.ndarray[Any, Any]

WIDTH, HEIGHT, FOCAL_PX, SUPERSAMPLING = 480, 270, 440.0, 2
FRAME_M, TEXEL_M, HALF_WIDTH_M, ROAD_M = 0.4, 0.1, 75.0, 5
STRIP, SIGHT = 1000, 1150  # rows of the ground: made together, seen together
NEAR_M, FAR_M = 8, 110
FACE = 96
CORNERS = np.array([[0, 0], [FACE, 0], [FACE, FACE], [0, FACE]], np.float32)
K = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1 / SUPERSAMPLING]]) * SUPERSAMPLING


@dataclass
class Box:
    """A house or a vehicle: half its width and length, its height, its place, and how far it drives in a frame."""

    x: float
    y: float
    half_x: float
    half_y: float
    height: float
    seed: int
    colour: Array
    start: int = 0
    step: float = 0.0
    faces: list[Array] | None = None


def noise(height: int, width: int, octaves: list[tuple[int, float]], rng: np.random.Generator) -> Array:
    """Noise of several sizes, mostly grey."""
    total = np.zeros((height, width, 3), np.float32)
    for size, gain in octaves:
        small = rng.random((height // size + 2, width // size + 2, 3), dtype=np.float32) - 0.5
        small = 0.7 * small.mean(2, keepdims=True) * 1.7 + 0.3 * small
        total += gain * cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    return total


def ground_of(length_m: float, rng: np.random.Generator) -> Array:
    """The ground with its road, in texels; row 0 is where the flight begins."""
    height, width = int(length_m / TEXEL_M), int(2 * HALF_WIDTH_M / TEXEL_M)
    left, right = int((HALF_WIDTH_M - ROAD_M) / TEXEL_M), int((HALF_WIDTH_M + ROAD_M) / TEXEL_M)
    ground = np.empty((height, width, 3), np.uint8)
    for top in range(0, height, STRIP):
        strip = noise(min(STRIP, height - top), width, [(3, 70), (9, 70), (40, 60), (200, 50)], rng)
        strip += np.array([80, 105, 100], np.float32)
        strip[:, left:right] = 95 + 0.45 * (strip[:, left:right] - 95)
        ground[top : top + STRIP] = np.clip(strip, 0, 255)
    for y in range(0, height, 90):
        ground[y : y + 30, width // 2 - 1 : width // 2 + 2] = 225
    ground[:, [left, right]] = 200
    return ground


def faces_of(box: Box, gain: float) -> list[Array]:
    """Roof, left, right and back."""
    rng = np.random.default_rng(box.seed)
    octaves = [(3, gain), (10, gain), (30, gain)]
    return [np.clip(noise(FACE, FACE, octaves, rng) + box.colour, 0, 255).astype(np.uint8) for _ in range(4)]


def houses_of(length_m: float, rng: np.random.Generator) -> list[Box]:
    """Three rows on either side of the road."""
    houses = []
    for y in np.arange(12, length_m, 16.0):
        for side in (-1, 1):
            for row in (14, 32, 52):
                place = side * (row + rng.uniform(-3, 3)), y + rng.uniform(-4, 4)
                size = rng.uniform(2.5, 5.5), rng.uniform(2.5, 5.5), rng.uniform(2.5, 9)
                seed = int(rng.integers(1 << 31))
                houses.append(Box(*place, *size, seed, rng.uniform(60, 190, 3).astype(np.float32)))
    return houses


def vehicles_of(num_frames: int, rng: np.random.Generator) -> list[Box]:
    """One every seventy frames; they begin out of sight."""
    vehicles = []
    for start in range(0, num_frames + 1, 70):
        half_y, kind, here = rng.uniform(2.1, 2.6), rng.integers(3), FRAME_M * start
        if kind == 0:
            x, y, step = -2.4, here + 100, -0.6
        elif kind == 1:
            x, y, step = 2.4, here + 10, FRAME_M + rng.uniform(0.25, 0.5)
        else:
            x, y, step = 2.4, here + 100, FRAME_M - rng.uniform(0.2, 0.35)
        seed, colour = int(rng.integers(1 << 31)), rng.uniform(40, 220, 3).astype(np.float32)
        vehicle = Box(x, y, 0.95, half_y, 1.55, seed, colour, start, step)
        vehicle.faces = faces_of(vehicle, 35)
        for face in vehicle.faces[1:]:
            face[10:42, 8:88] = (50, 40, 35)
            face[10:42, 44:52] = colour
        vehicles.append(vehicle)
    return vehicles


def camera_at(frame: int) -> tuple[Array, Array]:
    """Rotation to the camera (x right, y down) and centre (z up)."""
    t = frame * 0.1
    centre = np.array([1.5 * np.sin(0.11 * t), FRAME_M * frame, 25 + 2 * np.sin(0.07 * t)])
    pitch, yaw, roll = np.radians([35 + 2 * np.sin(0.2 * t), 4 * np.sin(0.09 * t), 1.5 * np.sin(0.31 * t)])
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x, y = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    return np.stack([x, y, forward]), centre


def draw_face(
    picture: Array, rotation: Array, centre: Array, corners: list[list[float]], face: Array, shade: float
) -> None:
    """A face over what is there already; its corners go round, the first is the texture's origin."""
    in_camera = (np.array(corners) - centre) @ rotation.T
    if in_camera[:, 2].min() < 2:
        return
    pixels = in_camera @ K.T
    pixels = (pixels[:, :2] / pixels[:, 2:]).astype(np.float32)
    low = np.maximum(np.floor(pixels.min(0)).astype(int), 0)
    high = np.minimum(np.ceil(pixels.max(0)).astype(int) + 1, np.array(picture.shape[1::-1]))
    if (high - low < 1).any():
        return
    pixels -= low
    size = tuple(int(v) for v in high - low)
    warp = cv2.getPerspectiveTransform(CORNERS, pixels)
    part = cv2.warpPerspective(face, warp, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(mask, np.round(pixels * 16).astype(np.int32), 255, shift=4)
    region = picture[low[1] : high[1], low[0] : high[0]]
    np.copyto(region, (part * shade).astype(np.uint8), where=mask[..., None] > 0)


def draw_box(picture: Array, rotation: Array, centre: Array, box: Box, y: float) -> None:
    """The faces of a box that can be seen."""
    if box.faces is None:
        box.faces = faces_of(box, 80)
    roof, left, right, back = box.faces
    x0, x1, y0, y1, h = box.x - box.half_x, box.x + box.half_x, y - box.half_y, y + box.half_y, box.height
    seen = []
    if centre[0] < x0:
        seen.append(([[x0, y1, h], [x0, y0, h], [x0, y0, 0], [x0, y1, 0]], left, 0.8))
    if centre[0] > x1:
        seen.append(([[x1, y0, h], [x1, y1, h], [x1, y1, 0], [x1, y0, 0]], right, 0.9))
    if centre[1] < y0:
        seen.append(([[x0, y0, h], [x1, y0, h], [x1, y0, 0], [x0, y0, 0]], back, 0.6))
    seen.append(([[x0, y1, h], [x1, y1, h], [x1, y0, h], [x0, y0, h]], roof, 1.0))
    for corners, face, shade in seen:
        draw_face(picture, rotation, centre, corners, face, shade)


def picture_at(frame: int, ground: Array, boxes: list[Box]) -> Array:
    """One frame, the far before the near."""
    rotation, centre = camera_at(frame)
    first = min(max(0, int((centre[1] + 5) / TEXEL_M)), len(ground) - 1)
    world_from_texel = np.array([[TEXEL_M, 0, -HALF_WIDTH_M], [0, TEXEL_M, first * TEXEL_M], [0, 0, 0]])
    warp = K @ rotation @ (world_from_texel - np.outer(centre, [0, 0, 1]))
    size = (WIDTH * SUPERSAMPLING, HEIGHT * SUPERSAMPLING)
    part = ground[first : first + SIGHT]
    picture = cv2.warpPerspective(part, warp, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    places = [(box, box.y + box.step * (frame - box.start)) for box in boxes if frame >= box.start]
    seen = [(box, y) for box, y in places if NEAR_M < y - centre[1] < FAR_M]
    seen.sort(key=lambda place: -np.hypot(place[1] - centre[1], place[0].x - centre[0]))
    for box, y in seen:
        draw_box(picture, rotation, centre, box, y)
    return cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def forget(houses: list[Box], y: float) -> None:
    """The pictures of what lies behind are let go."""
    for house in houses:
        if house.faces is not None and house.y < y - 20:
            house.faces = None


def main() -> None:
    num_frames, video = int(sys.argv[1]), sys.argv[2]
    cv2.setNumThreads(1)
    rng = np.random.default_rng(3)
    length_m = FRAME_M * num_frames + 130
    ground, houses = ground_of(length_m, rng), houses_of(length_m, rng)
    vehicles = vehicles_of(num_frames, rng)
    raw = f"-f rawvideo -pix_fmt bgr24 -s {WIDTH}x{HEIGHT} -r 10 -i - -threads 1"
    coded = "-c:v libx264 -preset veryfast -crf 18 -g 50 -pix_fmt yuv420p"
    command = ["ffmpeg", "-loglevel", "error", "-y", *raw.split(), *coded.split(), video]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        for frame in range(num_frames):
            encoder.stdin.write(picture_at(frame, ground, houses + vehicles).tobytes())
            forget(houses, FRAME_M * frame)
        encoder.stdin.close()
    sys.exit(encoder.returncode)


if __name__ == "__main__":
    main()
