#!/usr/bin/env python3
"""Inputs of hovering sequences (logs and map points with noise), and errors of a run and of a homography.

``inputs`` writes a log of a drone (video.SRT) and points of a map (points.geojson) of a sequence, with errors of their
kind by a seed. ``compare`` states the errors of a run's ground tracks, parked cars apart, and of a homography from
the image to four and more points of the map with frames registered to the first one, at the middles of the same masks
(geo-trax's way).
``recall`` states in how many frames a run has masks of the driven vehicles, ``masks`` how well those of its ground
tracks agree with the true ones. ``plane`` states the error of the ground's normal, of each of its sources, and of the
focal length. ``sizes`` states the errors of lengths, widths and axes by ground tracks, and of meters. ``relief`` states
how much larger the driven vehicle looks on the ground than on one plane, and how much its masks vary.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tractrix_dataset.mesh import read_ply
from tractrix_dataset.vehicles.heavy import FLEET

LATITUDE, LONGITUDE = 48.1, 9.2
# Metres per radian of latitude and longitude there (WGS 84).
RADII = (6370500.0, 6390000.0 * np.cos(np.radians(LATITUDE)))
# Standard deviations of the inputs: gimbal's yaw, pitch, roll (degrees), position and height (m), map (m), pixel.
GIMBAL_STD, RECEIVER_STD, HEIGHT_STD, MAP_STD, PIXEL_STD = (3.0, 0.7, 0.5), 2.0, 1.5, 0.3, 1.0
# The same of a stated focal length, as a share: video modes show less than the whole sensor.
FOCAL_STD = 0.05
# Where points are picked, as shares of width and height.
PICKED = ((0.12, 0.2), (0.88, 0.25), (0.85, 0.85), (0.15, 0.8), (0.5, 0.55))
# Largest distance of ground from the vertices of its mesh, meters.
SPACING_M = 3.0
# Height above the ground at which vehicles are seen, metres: half of a car's.
MIDDLE_M = 0.7
# Distance within which positions are those of a true vehicle, metres; of a parked car half of the 5.5 m between bays.
NEAR_M, NEAR_PARKED_M = 8.0, 2.7
# Fewest pixels of a mask whose size counts, fewest masks on a vehicle.
MIN_AREA, MIN_MASKS = 40, 6


@dataclass
class Truth:
    """Cameras and vehicles of a sequence (N, 4, 4), and the plane that fits all positions of vehicles."""

    scene: dict
    cameras: np.ndarray
    vehicles: dict[str, np.ndarray]
    point: np.ndarray
    normal: np.ndarray

    @classmethod
    def read(cls, folder: Path) -> Truth:
        scene = json.loads((folder / "scene.json").read_text())
        frames = scene["frames"]
        vehicles = {scene["vehicle"]: np.array([f["T_world_object"] for f in frames])}
        for k, name in enumerate(scene["others"]):
            vehicles[f"{name} {k + 1}"] = np.array([f["T_world_others"][k] for f in frames])
        positions = np.concatenate([poses[:, :3, 3] for poses in vehicles.values()])
        normal = np.linalg.svd(positions - positions.mean(0))[2][2]
        cameras = np.array([f["T_world_camera"] for f in frames])
        return cls(scene, cameras, vehicles, positions.mean(0), normal * np.sign(normal[2]))

    def on_ground(self, frame: int, pixel: np.ndarray) -> np.ndarray:
        """The point of the plane at a pixel."""
        camera = self.cameras[frame]
        ray = camera[:3, :3] @ np.linalg.solve(np.array(self.scene["K"]), [*pixel, 1.0])
        return camera[:3, 3] + ray * ((self.point - camera[:3, 3]) @ self.normal) / (ray @ self.normal)


def to_map(position: np.ndarray) -> tuple[float, float]:
    """Longitude and latitude of metres east and north."""
    return LONGITUDE + np.degrees(position[0] / RADII[1]), LATITUDE + np.degrees(position[1] / RADII[0])


def from_map(longitude: float, latitude: float) -> np.ndarray:
    """Metres east and north."""
    return np.array([np.radians(longitude - LONGITUDE) * RADII[1], np.radians(latitude - LATITUDE) * RADII[0]])


def in_image(truth: Truth, frame: int, point: np.ndarray) -> np.ndarray | None:
    """The pixel at which a point is seen; ``None`` behind the camera."""
    camera = truth.cameras[frame]
    seen = np.array(truth.scene["K"]) @ (camera[:3, :3].T @ (point - camera[:3, 3]))
    return seen[:2] / seen[2] if seen[2] > 0 else None


def on_mesh(truth: Truth, vertices: np.ndarray, frame: int, pixel: np.ndarray) -> np.ndarray | None:
    """The point of the ground as it is at a pixel, by the plane of the vertices near it; ``None`` beyond them."""
    camera, at = truth.cameras[frame], truth.on_ground(frame, pixel)
    ray = at - camera[:3, 3]
    # Each round leaves the ratio of the ground's slope to that of the sight.
    for _ in range(8):
        near = vertices[np.argsort(np.linalg.norm(vertices[:, :2] - at[:2], axis=1))[:12]]
        level = np.column_stack([near[:, :2] - at[:2], np.ones(len(near))])
        height = np.linalg.lstsq(level, near[:, 2], rcond=None)[0][2]
        at = camera[:3, 3] + ray * (height - camera[2, 3]) / ray[2]
    nearest = np.linalg.norm(vertices[:, :2] - at[:2], axis=1).min()
    return at if nearest < SPACING_M else None


def picked(sequence: Path, truth: Truth, r: np.random.Generator, heights: bool) -> list[dict]:
    """Points of a map as GeoJSON features, with errors; with ``heights`` on the ground as it is, at parked cars too."""
    features = []
    size = np.array([truth.scene["width"], truth.scene["height"]])
    vertices = read_ply(sequence / "ground_mesh.ply")[0] if heights else np.empty((0, 3))
    pixels = [np.array(share) * size for share in PICKED]
    if heights:
        seen = [in_image(truth, 0, np.array(car["position"])) for car in truth.scene.get("parked", [])]
        pixels += [pixel for pixel in seen if pixel is not None and (pixel > 0).all() and (pixel < size).all()]
    for pixel in pixels:
        at = on_mesh(truth, vertices, 0, pixel) if heights else truth.on_ground(0, pixel)
        if at is None:
            continue
        place = [*to_map(at[:2] + r.normal(0, MAP_STD, 2)), *([400 + at[2] + r.normal(0, MAP_STD)] if heights else [])]
        x, y = pixel + r.normal(0, PIXEL_STD, 2)
        geometry = {"type": "Point", "coordinates": place}
        features.append({"type": "Feature", "geometry": geometry, "properties": {"x": x, "y": y}})
    return features


def write_inputs(sequence: Path, output: Path, seed: int, heights: bool) -> None:
    """Writes video.SRT and points.geojson, with ``heights`` of points of the ground as it is, and copies the video."""
    output.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(sequence / "video.mp4", output / "video.mp4")
    truth, r = Truth.read(sequence), np.random.default_rng(seed)
    gimbal, position = r.normal(0, GIMBAL_STD), np.array([*r.normal(0, RECEIVER_STD, 2), r.normal(0, HEIGHT_STD)])
    step = 1.0 / truth.scene["fps"]
    error = np.exp(np.random.default_rng([seed, 1]).normal(0, FOCAL_STD))
    film_mm = 35.3 * truth.scene["K"][0][0] / truth.scene["width"] * error
    lines = []
    for k, camera in enumerate(truth.cameras):
        ahead, right = camera[:3, 2], camera[:3, 0]
        yaw, pitch = np.arctan2(ahead[0], ahead[1]), np.arcsin(ahead[2])
        level = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
        roll = np.arctan2(right @ np.cross(ahead, level), right @ level)
        yaw, pitch, roll = np.degrees([yaw, pitch, roll]) + gimbal
        at = camera[:3, 3] - [0, 0, truth.point[2]] + position
        longitude, latitude = to_map(at)
        start, end = (f"00:00:{t:06.3f}".replace(".", ",") for t in (k * step, (k + 1) * step - 1e-3))
        lines += [f"{k + 1}", f"{start} --> {end}", f"FrameCnt: {k + 1}, DiffTime: 100ms"]
        lines += [
            f"[focal_len: {film_mm:.2f}] [latitude: {latitude:.6f}] [longitude: {longitude:.6f}] "
            f"[rel_alt: {at[2]:.3f} abs_alt: {at[2] + 400:.3f}] "
            f"[gb_yaw: {yaw:.1f} gb_pitch: {pitch:.1f} gb_roll: {roll:.1f}]",
            "",
        ]
    (output / "video.SRT").write_text("\n".join(lines))
    features = picked(sequence, truth, r, heights)
    (output / "points.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}, indent=1))


def registered(video: Path, n_frames: int) -> list[np.ndarray]:
    """Homographies from each frame to the first, by ORB features."""
    capture, orb = cv2.VideoCapture(str(video)), cv2.ORB_create(800)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    found, first = [], None
    for _ in range(n_frames):
        good, image = capture.read()
        if not good:
            break
        points, words = orb.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), None)
        first = first or (points, words)
        matches = matcher.match(words, first[1])
        here = np.array([points[match.queryIdx].pt for match in matches])
        there = np.array([first[0][match.trainIdx].pt for match in matches])
        found.append(cv2.findHomography(here, there, cv2.RANSAC, 2.0)[0])
    return found


def apply(homography: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """A point under a homography."""
    mapped = homography @ [*pixel, 1.0]
    return mapped[:2] / mapped[2]


def by_homography(
    to_first: list[np.ndarray], run: Path, points: Path, object_id: int, names: dict[int, str]
) -> dict[int, np.ndarray]:
    """Positions of an object by frame, metres east and north, at the middles of the boxes of its masks."""
    features = json.loads(points.read_text())["features"]
    pixels = np.array([[f["properties"]["x"], f["properties"]["y"]] for f in features])
    ground = np.array([from_map(*f["geometry"]["coordinates"][:2]) for f in features])
    to_ground = cv2.findHomography(pixels, ground)[0]
    found = {}
    for frame, name in names.items():
        mask = cv2.imread(str(run / "tracks" / str(object_id) / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
        if mask is not None and mask.any():
            rows, columns = np.nonzero(mask)
            middle = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
            found[frame] = apply(to_ground @ to_first[frame], middle)
    return found


def compare(sequence: Path, run: Path, points: Path | None) -> None:
    """Prints the errors of the ground tracks of a run that are near a driven vehicle or a parked one."""
    truth = Truth.read(sequence)
    content = json.loads((run / "trajectories.json").read_text())
    if (content.get("metric") or {}).get("origin") is None:
        raise SystemExit(f"{run}: no positions on the map; run with --map-points or a log with gimbal angles")
    to_first = registered(sequence / "video.mp4", len(truth.cameras)) if points is not None else []
    total, total_stds, total_by_homography = [], [], []
    parked = np.array([car["position"][:2] for car in truth.scene.get("parked", [])]).reshape(-1, 2)
    at_rest, at_rest_stds = [], []
    for track in content["ground_tracks"]:
        places = {f["frame"]: from_map(f["longitude"], f["latitude"]) for f in track["frames"]}
        positions = np.array(list(places.values()))
        to_parked = np.linalg.norm(positions[:, None] - parked, axis=2)
        car = int(np.argmin(to_parked.mean(0))) if len(parked) else None
        offs = {
            name: np.array([at - poses[k][:2, 3] for k, at in places.items()]) for name, poses in truth.vehicles.items()
        }
        name = min(offs, key=lambda name: float(np.median(np.linalg.norm(offs[name], axis=1))))
        distance = float(np.median(np.linalg.norm(offs[name], axis=1)))
        stds = [f["place_std_m"][:2] for f in track["frames"]]
        if car is not None and np.quantile(to_parked[:, car], 0.9) <= min(distance, NEAR_PARKED_M):
            at_rest.append(positions - parked[car])
            at_rest_stds.extend(stds)
        elif distance <= NEAR_M:
            _state(f"ground track {track['id']} = {name}", offs[name], stds)
            total.append(offs[name])
            total_stds.extend(stds)
            if points is not None:
                names = {f["frame"]: f["name"] for f in track["frames"]}
                found = by_homography(to_first, run, points, track["id"], names)
                total_by_homography.append(np.array([at - truth.vehicles[name][k][:2, 3] for k, at in found.items()]))
                _state(f"homography {track['id']} = {name}", total_by_homography[-1], [])
    if total:
        _state("all ground tracks", np.concatenate(total), total_stds)
    if total_by_homography:
        _state("all by homography", np.concatenate(total_by_homography), [])
    if at_rest:
        means = [float(np.linalg.norm(errors, axis=1).mean()) for errors in at_rest]
        print("parked cars, mean error of each:", ", ".join(f"{mean:.2f}" for mean in sorted(means)))
        _state(f"all {len(at_rest)} ground tracks of parked cars", np.concatenate(at_rest), at_rest_stds)


def compare_live(sequence: Path, run: Path) -> None:
    """Prints the errors of the positions on the map of a live run, by state and method, of the vehicles that move."""
    truth = Truth.read(sequence)
    # Those that stand are no part of the truth: a vehicle is one that leaves its place by this.
    moved_m = 8.0
    tracks: dict[int, list[tuple[np.ndarray, dict]]] = {}
    for line in map(json.loads, (run / "live.jsonl").read_text().splitlines()):
        if line["kind"] == "vehicle" and line["geo"] is not None:
            at = from_map(line["geo"]["longitude"], line["geo"]["latitude"])
            tracks.setdefault(line["id"], []).append((at, line))
    errors: dict[tuple[str, str], list[tuple[float, float]]] = {}
    others = 0
    for track in tracks.values():
        finals = np.array([at for at, line in track if line["state"] == "final"])
        middle = np.median(finals, axis=0) if len(finals) else np.zeros(2)
        has_moved = len(finals) and np.quantile(np.linalg.norm(finals - middle, axis=1), 0.8) > moved_m / 2
        offs = [
            np.array([np.linalg.norm(at - poses[line["frame"]][:2, 3]) for at, line in track])
            for poses in truth.vehicles.values()
        ]
        off = min(offs, key=np.median)
        if not has_moved or np.median(off) > NEAR_M:
            others += 1
            continue
        for error, (_, line) in zip(off, track, strict=True):
            kind = (line["state"], line["method"])
            errors.setdefault(kind, []).append((float(error), line["geo"]["horizontal_std"]))
    for (state, method), pairs in sorted(errors.items()):
        size, std = np.array(pairs).T
        # Of two axes 39, 86, 99 % are within 1, 2, 3 standard deviations of one.
        inside = ", ".join(f"{100 * float((size < k * std / np.sqrt(2)).mean()):.0f}" for k in (1, 2, 3))
        print(
            f"{state}, {method}: {len(size)} positions, mean {size.mean():.2f} m, "
            f"95 % {np.quantile(size, 0.95):.2f} m, within 1, 2, 3 σ of an axis {inside} %, mean σ {std.mean():.2f} m"
        )
    print(f"{others} tracks of others")


def recall(sequence: Path, run: Path) -> None:
    """Prints in how many frames a mask of a run has the middle of each driven vehicle, of those that show it whole."""
    # Length of the segment that stands for its size, meters; a mask of more than its square times this is none of it.
    length_m, most_areas = 4.2, 6.0
    truth = Truth.read(sequence)
    intrinsics, size = np.array(truth.scene["K"]), np.array([truth.scene["width"], truth.scene["height"]])
    folders = [folder for folder in (run / "tracks").iterdir() if folder.is_dir()]
    files = {int(file.name.split(".")[0]): file for folder in folders for file in folder.glob("*.png")}
    found: dict[str, list[tuple[float, set[str]]]] = {name: [] for name in truth.vehicles}
    for frame, camera in enumerate(truth.cameras):
        name = files[frame].name if frame in files else ""
        present = [folder for folder in folders if name and (folder / name).is_file()]
        masks = {folder.name: cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE) for folder in present}
        for vehicle, poses in truth.vehicles.items():
            along = np.array([[x, 0, MIDDLE_M, 1] for x in (0, length_m / 2, -length_m / 2)])
            in_camera = intrinsics @ (np.linalg.inv(camera) @ poses[frame] @ along.T)[:3]
            middle, *ends = (in_camera[:2] / in_camera[2]).T
            length = float(np.linalg.norm(ends[0] - ends[1]))
            if (middle < length / 2).any() or (middle > size - length / 2).any():
                continue
            x, y = middle.astype(int)
            ids = {key for key, mask in masks.items() if mask[y, x] and np.count_nonzero(mask) < most_areas * length**2}
            found[vehicle].append((length, ids))
    for vehicle, frames in found.items():
        if frames:
            ids = set().union(*(ids for _, ids in frames))
            hits, mean = sum(bool(ids) for _, ids in frames), np.mean([length for length, _ in frames])
            print(f"{vehicle}, {mean:.0f} px: {hits} of {len(frames)} frames, {len(ids)} ids")


def masks(sequence: Path, run: Path) -> None:
    """Prints the mean intersection over union of the masks of ground tracks with the driven vehicles they lie on."""
    truth, means = Truth.read(sequence), []
    for track in json.loads((run / "trajectories.json").read_text())["ground_tracks"]:
        overlaps = []
        for frame in track["frames"]:
            name = f"{frame['name']}.png"
            mask = cv2.imread(str(run / "tracks" / str(track["id"]) / name), cv2.IMREAD_GRAYSCALE)
            labels = cv2.imread(str(sequence / truth.scene["frames"][frame["frame"]]["mask"]), cv2.IMREAD_GRAYSCALE)
            if mask is None:
                continue
            mask, vehicles = mask > 0, cv2.connectedComponents((labels > 0).astype(np.uint8))[1]
            shared = np.bincount(vehicles[mask])[1:]
            # A mask that shares less with a vehicle is of another thing.
            if len(shared) and shared.max() >= 0.2 * mask.sum():
                true = vehicles == 1 + int(np.argmax(shared))
                overlaps.append((mask & true).sum() / (mask | true).sum())
        if len(overlaps) >= MIN_MASKS:
            means.append(float(np.mean(overlaps)))
            print(f"ground track {track['id']}: IoU {means[-1]:.3f} in {len(overlaps)} frames")
    if means:
        print(f"all {len(means)}: IoU {np.mean(means):.3f}")


def plane(sequence: Path, run: Path) -> None:
    """Prints the errors of the ground's normal in the first frame and of the focal length."""
    truth = Truth.read(sequence)
    up = truth.cameras[0][:3, :3].T @ truth.normal
    true = np.degrees([np.arctan2(-up[2], -up[1]), np.arcsin(up[0])])
    stages = json.loads((run / "run.json").read_text())["stages"]
    background, found = stages["background"]["figures"], stages["ground"]["figures"].get("hovering")
    focal, true_focal = background["focal_length_px"], truth.scene["K"][0][0]
    std = background["focal_std_px"]
    sigma = "held" if std is None else f"± {100 * std / focal:.1f} %"
    print(f"focal length {focal:.0f} px, {100 * (focal / true_focal - 1):+.1f} % {sigma}")
    if found is None:
        print("no ground")
        return
    print(f"ground: pitch {found['pitch_deg'] - true[0]:+.2f} of {true[0]:.1f}°, tilt ± {found['tilt_std_deg']:.2f}°")
    for source in found["sources"]:
        offs = [
            f"{at - of_true:+.2f} ± {std:.2f}°"
            for at, of_true, std in zip(source["tilt_deg"], true, source["std_deg"], strict=True)
            if std is not None
        ]
        print(f"  {source['source']}: pitch and tilt {', '.join(offs)}")


def sizes(sequence: Path, run: Path) -> None:
    """Prints the errors of sizes and axes by ground tracks, and of the distances in meters."""
    truth = Truth.read(sequence)
    content = json.loads((run / "trajectories.json").read_text())
    scale = (content.get("metric") or {}).get("scale")
    if scale is None:
        raise SystemExit(f"{run}: no meters")
    poses, parked = images(run), truth.scene.get("parked", [])
    at_rest = np.array([car["position"] for car in parked]).reshape(-1, 3)
    shares = []
    for track in content["ground_tracks"]:
        places, names = [], {name: [] for name in truth.vehicles}
        for f in track["frames"]:
            camera = truth.cameras[f["frame"]]
            ray = _in_world(truth, f, poses[f["name"]], scale) - camera[:3, 3]
            on_plane = ((truth.point - camera[:3, 3]) @ truth.normal) / (ray @ truth.normal)
            shares.append(1 / on_plane)
            places.append(camera[:3, 3] + on_plane * ray)
            for name, positions in names.items():
                positions.append(np.linalg.norm(places[-1] - truth.vehicles[name][f["frame"]][:3, 3]))
        name = min(names, key=lambda name: float(np.median(names[name])))
        distance = float(np.median(names[name]))
        spec = FLEET[name.split()[0]]
        size, heading = [spec.length, spec.width, spec.height], None
        if len(parked):
            to_parked = np.linalg.norm(at_rest - np.mean(places, axis=0), axis=1)
            car = int(np.argmin(to_parked))
            if to_parked[car] < min(distance, NEAR_PARKED_M):
                name, distance = f"parked {parked[car]['model']}", float(to_parked[car])
                size, heading = parked[car]["size_m"], parked[car]["heading_rad"]
        if distance > NEAR_PARKED_M:
            continue
        words = []
        for key, true in zip(("length_m", "width_m", "height_m"), size, strict=True):
            found = (track.get("dimensions") or {}).get(key)
            words.append(f"{found['value'] - true:+.2f} ± {found['std']:.2f} of {true:.2f} m" if found else "–")
        axis = track.get("axis_deg")
        if axis is not None and heading is not None and content["metric"]["origin"] is not None:
            off = (axis["value"] - 90 + np.degrees(heading) + 90) % 180 - 90
            words.append(f"axis {off:+.1f} ± {axis['std']:.1f}°")
        print(f"ground track {track['id']} = {name}: {', '.join(words)}")
    std = content["metric"]["std"]["scale"] / scale
    print(f"distances over the true ones: {float(np.median(shares)):.3f} ± {std:.3f}")


def relief(sequence: Path, run: Path) -> None:
    """Prints how much the ground's shape shows in the size of the driven vehicle, and how much masks vary."""
    truth = Truth.read(sequence)
    corners = read_ply(sequence / "object_mesh.ply")[0]
    poses = truth.vehicles[truth.scene["vehicle"]]
    places = poses[:, :3, 3]
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1))])
    first = along <= along[-1] / 3
    rise = places[:, 2] - np.polyval(np.polyfit(along[first], places[first, 2], 1), along)
    shown, varies, by_run = [], [], []
    for k, camera in enumerate(truth.cameras):
        mask = cv2.imread(str(sequence / truth.scene["frames"][k]["mask"]), cv2.IMREAD_GRAYSCALE) == 1
        if mask[[0, -1]].any() or mask[:, [0, -1]].any() or mask.sum() < MIN_AREA:
            continue
        found = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0 for path in run.glob(f"tracks/*/{k:06d}.*png")]
        best = max(found, key=lambda found: int((found & mask).sum()), default=np.zeros_like(mask))
        seen = (corners @ poses[k][:3, :3].T + poses[k][:3, 3] - camera[:3, 3]) @ camera[:3, :3]
        pixels = seen @ np.array(truth.scene["K"]).T
        hull = cv2.contourArea(cv2.convexHull((pixels[:, :2] / pixels[:, 2:]).astype(np.float32)))
        varies.append(0.5 * np.log(_hull_area(mask) / hull))
        if (best & mask).any():
            by_run.append(0.5 * np.log(_hull_area(best) / hull))
        shown.append(np.log1p(rise[k] / (camera[2, 3] - places[k, 2])))
    print(
        f"{truth.scene['vehicle']}: rises by {rise.max():.2f} m over {along[-1]:.0f} m, which shows as "
        f"{100 * max(shown):+.1f} % of its size; true masks vary by {100 * float(np.std(varies)):.1f} %, those of the "
        f"run by {100 * float(np.std(by_run)):.1f} % (1σ)"
    )


def _hull_area(mask: np.ndarray) -> float:
    contours = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    return cv2.contourArea(cv2.convexHull(max(contours, key=cv2.contourArea)))


def _state(what: str, errors: np.ndarray, stds: list[list[float]]) -> None:
    size = np.linalg.norm(errors, axis=1)
    own = np.linalg.norm(errors - errors.mean(0), axis=1).mean()
    text = (
        f"{what}: mean {size.mean():.2f} m, 95 % {np.quantile(size, 0.95):.2f} m, without the common part {own:.2f} m"
    )
    if stds:
        off = np.abs(errors) / np.array(stds)
        inside = ", ".join(f"{100 * float((off <= k).mean()):.0f}" for k in (1, 2, 3))
        text += f"; within 1, 2, 3 σ {inside} %, mean σ {float(np.mean(stds)):.2f} m"
    print(text)


def images(run: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rotations and translations, camera from world, by image name."""
    lines = [line.split() for line in (run / "background" / "images.txt").read_text().splitlines()]
    found = {}
    for words in [words for words in lines if len(words) == 10 and words[0] != "#"]:
        w, x, y, z = map(float, words[1:5])
        rotation = cv2.Rodrigues(_rotation_vector(w, np.array([x, y, z])))[0]
        found[words[9]] = (rotation, np.array(list(map(float, words[5:8]))))
    return found


def _rotation_vector(w: float, v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return np.zeros(3) if length == 0 else v / length * 2 * np.arctan2(length, w)


def _in_world(truth: Truth, pose: dict, image: tuple[np.ndarray, np.ndarray], scale: float) -> np.ndarray:
    """A position of a run in the world of the truth, by the true camera of its frame."""
    in_camera = (image[0] @ np.array(pose["position"]) + image[1]) * scale
    camera = truth.cameras[pose["frame"]]
    return camera[:3, :3] @ in_camera + camera[:3, 3]


# What is stated of a sequence and a run, and its help.
OF_A_RUN = {
    "recall": (recall, "frames in which a run has masks of the driven vehicles"),
    "masks": (masks, "agreement of the masks of ground tracks with the true ones"),
    "plane": (plane, "errors of the ground's normal and of the focal length"),
    "sizes": (sizes, "errors of lengths, widths and axes of ground tracks, and of meters"),
    "relief": (relief, "what the ground's shape changes of the driven vehicle's size"),
}


def main() -> None:
    """Reads the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    inputs = commands.add_parser("inputs", help="write video.SRT and points.geojson")
    inputs.add_argument("sequence", type=Path)
    inputs.add_argument("output", type=Path)
    inputs.add_argument("--seed", type=int, default=1)
    inputs.add_argument("--heights", action="store_true", help="points with heights of the ground as it is")
    errors = commands.add_parser("compare", help="errors of the positions of a run, or of a live run on a map")
    errors.add_argument("sequence", type=Path)
    errors.add_argument("run", type=Path)
    errors.add_argument("--points", type=Path, help="points of the map, for the homography")
    for name, (_, text) in OF_A_RUN.items():
        of_run = commands.add_parser(name, help=text)
        of_run.add_argument("sequence", type=Path)
        of_run.add_argument("run", type=Path)
    arguments = parser.parse_args()
    if arguments.command in OF_A_RUN:
        OF_A_RUN[arguments.command][0](arguments.sequence, arguments.run)
    elif arguments.command == "inputs":
        write_inputs(arguments.sequence, arguments.output, arguments.seed, arguments.heights)
    elif (arguments.run / "live.jsonl").is_file() and not (arguments.run / "trajectories.json").is_file():
        compare_live(arguments.sequence, arguments.run)
    else:
        compare(arguments.sequence, arguments.run, arguments.points)


if __name__ == "__main__":
    main()
