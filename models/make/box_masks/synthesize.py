#!/usr/bin/env python3
"""Draws the data set's vehicles in random light on random ground: training tiles with exact masks, by the thousand.

A z-buffer of triangles, shadows on the ground, reflections of a plain sky; no Blender. A stopped run resumes.

    python synthesize.py --vehicles vehicles.npz --photos DIR --output DIR --files 200 --processes 16
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numba
import numpy as np
from crops import box_of
from tiles import EMPTY, SYNTHETIC, Tiles, degraded

SIDE, FINE = 300, 2
PER_FILE = 16
VIEWS = ("top", "front", "rear", "left", "right")
# Linear color and reflection at right angles, by material after body and plain.
LOOKS = {2: (0.018, 0.02), 3: (0.42, 0.3), 4: (0.035, 0.03), 5: (0.02, 0.04), 6: (0.6, 0.5), 7: (0.008, 0.0)}


@numba.njit(cache=True)
def rasterize(points, depth, owner, number, first):  # noqa: ANN001, ANN201
    """Draws triangles (n, 3, 3: x, y in pixels, 1 / z) into a buffer of 1 / z and one of triangle numbers."""
    height, width = depth.shape
    for t in range(len(points)):
        x0, y0, z0 = points[t, 0, 0], points[t, 0, 1], points[t, 0, 2]
        x1, y1, z1 = points[t, 1, 0], points[t, 1, 1], points[t, 1, 2]
        x2, y2, z2 = points[t, 2, 0], points[t, 2, 1], points[t, 2, 2]
        if z0 <= 0 or z1 <= 0 or z2 <= 0:
            continue
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        left, right = max(0, int(min(x0, x1, x2))), min(width - 1, int(max(x0, x1, x2)))
        top, bottom = max(0, int(min(y0, y1, y2))), min(height - 1, int(max(y0, y1, y2)))
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                u, v = x + 0.5, y + 0.5
                a = ((x1 - u) * (y2 - v) - (x2 - u) * (y1 - v)) / area
                b = ((x2 - u) * (y0 - v) - (x0 - u) * (y2 - v)) / area
                c = 1 - a - b
                if a < 0 or b < 0 or c < 0:
                    continue
                z = a * z0 + b * z1 + c * z2
                if z > depth[y, x]:
                    depth[y, x] = z
                    owner[y, x] = first + t
    return number


class Garage:
    """The vehicles that `export_vehicles.py` wrote."""

    def __init__(self, path: Path) -> None:
        content = np.load(path)
        self.names = [str(name) for name in content["names"]]
        self.content = {key: content[key] for key in content.files}
        for name in self.names:
            for what in ("corners", "normals"):
                self.content[f"{name}_{what}"] = self.content[f"{name}_{what}"].astype(np.float64)

    def __getitem__(self, key: str) -> np.ndarray:
        return self.content[key]

    def color(self, name: str, at: np.ndarray, normal: np.ndarray, paint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear color and gloss of a body's surface at points (n, 3)."""
        color = np.tile(paint, (len(at), 1))
        gloss = np.full(len(at), 0.05)
        view = np.zeros(len(at), int)
        view[normal[:, 0] > 0.33] = 1
        view[normal[:, 0] < -0.33] = 2
        view[normal[:, 1] > 0.6] = 3
        view[normal[:, 1] < -0.6] = 4
        for k, axes in enumerate(((0, 1), (1, 2), (1, 2), (0, 2), (0, 2))):
            rows = np.flatnonzero(view == k)
            if not len(rows):
                continue
            picture, area = self[f"{name}_{VIEWS[k]}"], self[f"{name}_{VIEWS[k]}_area"]
            share = (at[rows][:, axes] - area[:2]) / (area[2:] - area[:2])
            x = np.clip((share[:, 0] * picture.shape[1]).astype(int), 0, picture.shape[1] - 1)
            y = np.clip(((1 - share[:, 1]) * picture.shape[0]).astype(int), 0, picture.shape[0] - 1)
            drawn = picture[y, x].astype(float) / 255
            alpha = drawn[:, 3:]
            color[rows] = color[rows] * (1 - alpha) + alpha * drawn[:, :3] ** 2.2
            rough = self[f"{name}_{VIEWS[k]}_finish"][y, x].astype(float) / 255
            gloss[rows] = np.where(alpha[:, 0] > 0.5, 0.02 + 0.1 * (1 - rough) ** 2, 0.05)
        return color, gloss


def noise(shape: tuple[int, int], cells: float, r: np.random.Generator) -> np.ndarray:
    """Smooth noise around zero."""
    small = r.normal(size=(max(2, int(cells)), max(2, int(cells)))).astype(np.float32)
    return cv2.resize(small, shape[::-1], interpolation=cv2.INTER_CUBIC)


def ground_texture(photos: list[np.ndarray], r: np.random.Generator) -> np.ndarray:
    """A square linear texture, 24 m in 512 pixels: asphalt with lines, patches and borders, or part of a photograph."""
    size = 512
    if photos and r.random() < 0.35:
        photo = photos[int(r.integers(len(photos)))]
        part = min(photo.shape[:2], key=int)
        side = int(r.uniform(0.3, 1.0) * part)
        y, x = int(r.integers(photo.shape[0] - side + 1)), int(r.integers(photo.shape[1] - side + 1))
        texture = cv2.resize(photo[y : y + side, x : x + side], (size, size), interpolation=cv2.INTER_AREA)
        return (texture.astype(np.float32) / 255) ** 2.2
    value = r.uniform(0.03, 0.3)
    texture = np.full((size, size, 3), value, np.float32) * (1 + r.normal(0, 0.06, 3)).astype(np.float32)
    for cells, strength in ((4, 0.12), (24, 0.1), (110, 0.12), (500, 0.18)):
        texture *= 1 + r.uniform(0.2, 1) * strength * noise((size, size), cells, r)[..., None]
    for _ in range(int(r.integers(0, 4))):
        points = (r.uniform(0, size, 2) + r.normal(0, 60, (4, 2))).astype(np.int32)
        layer = cv2.fillConvexPoly(np.zeros((size, size), np.float32), cv2.convexHull(points), 1.0)
        texture *= 1 + layer[..., None] * r.uniform(-0.45, 0.4)
    if r.random() < 0.6:
        border = r.uniform(-200, 712)
        color = np.array([0.25, 0.24, 0.22]) * r.uniform(0.4, 2)
        if r.random() < 0.5:
            color = np.array([0.05, 0.10, 0.02]) * r.uniform(0.5, 3)
        edge = int(np.clip(border, 0, size))
        rows = slice(0, edge) if r.random() < 0.5 else slice(edge, size)
        shape = texture[rows].shape
        if shape[0] > 1:
            rough = 1 + 0.35 * noise(shape[:2], 160, r)[..., None] + 0.2 * noise(shape[:2], 20, r)[..., None]
            texture[rows] = color * rough
    for _ in range(int(r.integers(0, 5))):
        y, thick = int(r.integers(size)), int(r.integers(2, 6))
        paint = r.uniform(0.4, 0.85)
        dash = int(r.integers(20, 120))
        for start in range(0, size, dash * (2 if r.random() < 0.6 else 1)):
            a, b = (start, y), (start + dash, y)
            if r.random() < 0.25:
                a, b = a[::-1], b[::-1]
            cv2.line(texture, a, b, (paint, paint, paint * r.uniform(0.6, 1)), thick)
    return np.clip(texture, 0.003, 0.95)


def body_pattern(photos: list[np.ndarray], r: np.random.Generator) -> np.ndarray:
    """A linear texture for a body: camouflage of a few paints, or a photograph's part."""
    size = 256
    if photos and r.random() < 0.4:
        photo = photos[int(r.integers(len(photos)))]
        side = int(r.uniform(0.1, 0.6) * min(photo.shape[:2]))
        y, x = int(r.integers(photo.shape[0] - side + 1)), int(r.integers(photo.shape[1] - side + 1))
        part = cv2.resize(photo[y : y + side, x : x + side], (size, size), interpolation=cv2.INTER_AREA)
        return (part.astype(np.float64) / 255) ** 2.2
    pattern = np.tile(random_paint(r), (size, size, 1))
    for _ in range(int(r.integers(1, 4))):
        pattern[noise((size, size), r.uniform(5, 60), r) > r.uniform(-0.2, 0.7)] = random_paint(r)
    return pattern


def patterned(at: np.ndarray, normal: np.ndarray, pattern: np.ndarray, per_m: float) -> np.ndarray:
    """Colors of a pattern at points of a body."""
    u = np.where(np.abs(normal[:, 0]) > 0.6, at[:, 1], at[:, 0])
    v = np.where(np.abs(normal[:, 2]) > 0.6, at[:, 1], at[:, 2])
    return pattern[(v * per_m).astype(int) % 256, (u * per_m).astype(int) % 256]


def look_at(center: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """Rotation from world to camera, x right, y down, z forward."""
    z = (target - center) / np.linalg.norm(target - center)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * x + s * y, -s * x + c * y, z])


def random_paint(r: np.random.Generator) -> np.ndarray:
    """A linear color; half of them gray scale."""
    if r.random() < 0.55:
        value = r.uniform(0, 0.95) ** 1.8 + 0.008
        return np.array([value, value * r.uniform(0.95, 1.05), value * r.uniform(0.9, 1.1)])
    color = r.uniform(0, 1, 3) ** 2
    return 0.01 + color / color.max() * r.uniform(0.05, 0.8)


def scene(garage: Garage, photos: list[np.ndarray], r: np.random.Generator) -> tuple[np.ndarray, list[np.ndarray]]:
    """An sRGB image and the masks of its vehicles, that in the middle first."""
    names = [garage.names[int(r.integers(len(garage.names)))] for _ in range(1 + int(r.integers(0, 4)))]
    poses, taken = [], []
    for k, name in enumerate(names):
        length, width = garage[f"{name}_size"]
        is_free = k == 0 or r.random() < 0.3
        heading = r.uniform(0, 2 * np.pi) if is_free else taken[0][3] + r.choice([0, np.pi]) + r.normal(0, 0.05)
        for _ in range(20):
            at = np.zeros(2) if k == 0 else r.normal(0, 6, 2)
            c, s = np.cos(taken[0][3] if taken else 0), np.sin(taken[0][3] if taken else 0)
            free = True
            for x, y, (l2, w2), _ in taken:
                along, across = abs(c * (at[0] - x) + s * (at[1] - y)), abs(-s * (at[0] - x) + c * (at[1] - y))
                free &= along > (length + l2) / 2 + 0.3 or across > (width + w2) / 2 + 0.25
            if free or k == 0:
                taken.append((*at, (length, width), heading))
                poses.append((name, at, heading, random_paint(r)))
                break
    low = r.random() < 0.25
    elevation = np.radians(r.uniform(0.5, 14) if low else r.uniform(12, 80))
    azimuth = r.uniform(0, 2 * np.pi)
    length = garage[f"{names[0]}_size"][0]
    distance = length * np.exp(r.uniform(np.log(1.1), np.log(4 if low else 12))) + 2
    middle = np.array([0, 0, 0.7])
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    camera = middle + distance * away
    camera[2] = max(camera[2], 1.1)
    rotation = look_at(camera, middle + r.normal(0, 0.03, 3) * distance, np.radians(r.normal(0, 4)))
    side = SIDE * FINE
    focal = side * r.uniform(0.38, 0.5) * distance / length * 1.1

    def project(points: np.ndarray) -> np.ndarray:
        inside = (points - camera) @ rotation.T
        z = np.where(inside[..., 2] > 0.2, inside[..., 2], -1.0)
        image = focal * inside[..., :2] / z[..., None] + side / 2
        return np.concatenate([image, 1 / z[..., None]], -1)

    sun_height, sun_side = np.radians(r.uniform(14, 75)), r.uniform(0, 2 * np.pi)
    sun = np.array([np.cos(sun_side) * np.cos(sun_height), np.sin(sun_side) * np.cos(sun_height), np.sin(sun_height)])
    overcast = r.random() < 0.3
    sun_power, sky_power = (0.0, r.uniform(0.8, 1.4)) if overcast else (r.uniform(1.2, 3.0), r.uniform(0.3, 0.8))
    sky_color = np.array([0.75, 0.88, 1.1]) * sky_power
    sun_color = np.array([1.0, r.uniform(0.88, 1), r.uniform(0.72, 1)]) * sun_power
    depth, owner = np.zeros((side, side)), np.full((side, side), -1, np.int32)
    shade, dim = np.zeros((side, side)), np.zeros((side, side), np.float32)
    unused = np.full((side, side), -1, np.int32)
    corners, normals, materials, vehicles, firsts = [], [], [], [], [0]
    for k, (name, at, heading, _) in enumerate(poses):
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        world = garage[f"{name}_corners"] @ turn.T + np.array([*at, 0])
        rasterize(project(world), depth, owner, 0, firsts[-1])
        shadow = world - world[..., 2:] / sun[2] * sun
        rasterize(project(np.maximum(shadow, [-1e9, -1e9, 0])), shade, unused, 0, 0)
        length, width = garage[f"{name}_size"]
        foot = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length * 0.47, width * 0.46]
        along = garage[f"{name}_corners"][..., 0]
        foot[:, 0] += 0.5 * (along.min() + along.max())
        foot = project(np.column_stack([foot @ turn[:2, :2].T + at, np.zeros(4)]))
        if (foot[:, 2] > 0).all():
            cv2.fillConvexPoly(dim, np.rint(np.clip(foot[:, :2], -9999, 9999)).astype(np.int32), 1.0)
        corners.append(garage[f"{name}_corners"])
        normals.append(garage[f"{name}_normals"])
        materials.append(garage[f"{name}_materials"])
        vehicles.append(np.full(len(world), k))
        firsts.append(firsts[-1] + len(world))
    image = background(camera, rotation, focal, side, photos, r, sky_color)
    ground, on_ground = image
    dim = cv2.GaussianBlur(dim, (0, 0), max(1.0, 0.07 * focal / distance)) * r.uniform(0.5, 0.95)
    lit = cv2.GaussianBlur((shade > 0).astype(np.float32), (0, 0), r.uniform(0.6, 2.5))
    light = sky_color * 1.0 * (1 - dim[..., None]) + sun_color * sun[2] * (1 - lit[..., None])
    image = np.where(on_ground[..., None], ground * light, ground)
    rows, columns = np.nonzero(owner >= 0)
    triangle = owner[rows, columns]
    vehicle = np.concatenate(vehicles)[triangle]
    drawn, sight = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    rays = np.column_stack([(columns + 0.5 - side / 2) / focal, (rows + 0.5 - side / 2) / focal, np.ones(len(rows))])
    points = camera + (rays / depth[rows, columns][:, None]) @ rotation
    sight = points - camera
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    for k, (name, at, heading, paint) in enumerate(poses):
        chosen = np.flatnonzero(vehicle == k)
        if not len(chosen):
            continue
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        local = (points[chosen] - np.array([*at, 0])) @ turn
        number = triangle[chosen] - firsts[k]
        weights = barycentric(corners[k][number], local)
        normal = np.einsum("ni,nij->nj", weights, normals[k][number])
        normal /= np.maximum(1e-6, np.linalg.norm(normal, axis=1, keepdims=True))
        material = materials[k][number]
        color, gloss = garage.color(name, local, normal, paint)
        color[material == 1], gloss[material == 1] = paint, 0.05
        if r.random() < 0.3:
            share, body = r.uniform(0.4, 1.0), material <= 1
            pattern = patterned(local[body], normal[body], body_pattern(photos, r), r.uniform(20, 90))
            color[body] = color[body] * (1 - share) + share * pattern
        for m, (gray, shine) in LOOKS.items():
            color[material == m], gloss[material == m] = gray, shine
        normal = normal @ turn.T
        toward = sight[chosen]
        facing = np.abs((normal * toward).sum(1))
        bounce = toward - 2 * (normal * toward).sum(1)[:, None] * normal
        direct = np.maximum(0, normal @ sun)[:, None] * sun_color
        ambient = sky_color * (0.55 + 0.45 * normal[:, 2:]) + 0.12 * sun_color * np.maximum(0, -normal[:, 2:] + 0.3)
        ambient *= np.clip(0.35 + points[chosen][:, 2:] * 0.9, 0, 1)
        fresnel = (gloss + (1 - gloss) * 0.7 * (1 - facing) ** 5 * (gloss > 0))[:, None]
        up = np.clip(bounce[:, 2:] * 3 + 0.3, 0, 1)
        mirror = sky_color * (0.15 + 1.2 * up) + (1 - up) * 0.12
        glint = np.maximum(0, bounce @ sun)[:, None] ** 300 * sun_color * 8
        drawn[chosen] = color * (direct + ambient) * (1 - fresnel) + fresnel * (mirror + glint)
    image[rows, columns] = drawn
    exposure = r.uniform(0.5, 1.3) / max(0.05, float(np.percentile(image.mean(2), 85))) * 0.5
    image = np.clip(image * exposure, 0, 1) ** (1 / 2.2)
    image = cv2.resize((image * 255).astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    labels = np.full((side, side), -1, np.int32)
    labels[rows, columns] = vehicle
    masks = []
    for k in range(len(poses)):
        mask = cv2.resize((labels == k).astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
        masks.append((mask * 255).astype(np.uint8))
    return np.clip(image + 0.5, 0, 255).astype(np.uint8), masks


def barycentric(corners: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Weights (n, 3) of the corners at points of triangles."""
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], at - corners[:, 0]
    aa, ab, bb = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1)
    pa, pb = (p * a).sum(1), (p * b).sum(1)
    scale = np.maximum(1e-12, aa * bb - ab * ab)
    v, w = (bb * pa - ab * pb) / scale, (aa * pb - ab * pa) / scale
    return np.clip(np.column_stack([1 - v - w, v, w]), 0, 1)


def background(
    camera: np.ndarray,
    rotation: np.ndarray,
    focal: float,
    side: int,
    photos: list[np.ndarray],
    r: np.random.Generator,
    sky: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Linear colors of the ground, or of a photograph behind it above the horizon; whether it is ground."""
    at = np.arange(side) + 0.5 - side / 2
    rays = np.stack([*np.meshgrid(at / focal, at / focal), np.ones((side, side))], -1) @ rotation
    down = rays[..., 2] < -1e-3
    reach = np.where(down, -camera[2] / np.minimum(rays[..., 2], -1e-3), 1e6)
    far = reach * np.linalg.norm(rays[..., :2], axis=-1) > r.uniform(25, 120)
    on_ground = down & ~far
    texture = ground_texture(photos, r)
    turn, shift = r.uniform(0, 2 * np.pi), r.uniform(0, 512, 2)
    x, y = (camera[k] + reach * rays[..., k] for k in (0, 1))
    u = (np.cos(turn) * x - np.sin(turn) * y) * 512 / 24 + shift[0]
    v = (np.sin(turn) * x + np.cos(turn) * y) * 512 / 24 + shift[1]
    u, v = (np.where(on_ground, w, 0).astype(np.float32) for w in (u, v))
    # The pixel on the ground may be larger than that of the texture.
    blur = max(0.01, 0.4 * np.linalg.norm(camera) / focal * 512 / 24)
    texture = cv2.GaussianBlur(texture, (0, 0), blur)
    colors = cv2.remap(texture, u % 512, v % 512, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    behind = np.tile(sky * 0.7, (side, side, 1)).astype(np.float32)
    if photos and r.random() < 0.85:
        photo = photos[int(r.integers(len(photos)))]
        part = int(min(photo.shape[:2]) * r.uniform(0.2, 0.8))
        top, left = int(r.integers(photo.shape[0] - part + 1)), int(r.integers(photo.shape[1] - part + 1))
        behind = cv2.resize(photo[top : top + part, left : left + part], (side, side)).astype(np.float32) / 255
        behind = behind**2.2 * r.uniform(0.4, 1.2)
    return np.where(on_ground[..., None], colors, behind), on_ground


def work(job: tuple) -> int:
    """Makes one file of tiles; returns the number of new ones."""
    cv2.setNumThreads(1)
    output, vehicles, photo_paths, number = job
    if output.is_file():
        return 0
    r = np.random.default_rng([7, number])
    global _garage, _photos
    if "_garage" not in globals():
        _garage = Garage(vehicles)
        chosen = np.random.default_rng(os.getpid()).permutation(len(photo_paths))[:24]
        _photos = [cv2.cvtColor(cv2.imread(str(photo_paths[k])), cv2.COLOR_BGR2RGB) for k in chosen]
    tiles = Tiles()
    for _ in range(PER_FILE):
        image, masks = scene(_garage, _photos, r)
        seen = degraded(image, r) if r.random() < 0.5 else image
        for mask in masks:
            box = box_of(mask > 127)
            if box is None or min(box[2:] - box[:2]) < 14 or box[:2].min() < 1 or box[2:].max() > SIDE - 1:
                continue
            count, _, stats, _ = cv2.connectedComponentsWithStats((mask > 127).astype(np.uint8), connectivity=4)
            if count < 2 or stats[1:, cv2.CC_STAT_AREA].max() < 0.9 * (mask > 127).sum():
                continue
            tiles.add(seen, mask, box, SYNTHETIC)
        if r.random() < 0.3:
            corner, sides = r.uniform(0, SIDE * 0.7, 2), np.exp(r.uniform(np.log(20), np.log(120), 2))
            box = np.concatenate([corner, np.minimum(corner + sides, SIDE)])
            inside = sum(mask[int(box[1]) : int(box[3]) + 1, int(box[0]) : int(box[2]) + 1].mean() for mask in masks)
            if inside < 0.04 * 255:
                tiles.add(seen, np.zeros((SIDE, SIDE), np.uint8), box, EMPTY)
    tiles.save(output)
    return len(tiles.kind)


def main() -> None:
    """Reads the arguments and draws."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=Path, required=True)
    parser.add_argument("--photos", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    photos = sorted(arguments.photos.glob("*.webp"))
    names = [arguments.output / f"synthetic_{k:05d}.npz" for k in range(arguments.files)]
    jobs = [(name, arguments.vehicles, photos, k) for k, name in enumerate(names)]
    with ProcessPoolExecutor(arguments.processes) as pool:
        print("tiles:", sum(pool.map(work, jobs)), flush=True)


if __name__ == "__main__":
    main()
