#!/usr/bin/env python3
"""Renders single frames of the data set's town with a mask of every vehicle: training data of the box mask network.

Each scene is a trajectory of the data set with more vehicles of random paint around the target; each frame has a
camera and a sun of its own. A stopped run resumes: finished frames are kept.

    python render_frames.py --output DIR --scenes 60 --first-seed 100 --frames 12

with Python 3.11 and dataset/requirements.txt. Writes DIR/NNN_FF.jpg and DIR/NNN_FF.png: 0 background, 10 and more one
vehicle each.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "dataset"))

import bpy  # noqa: E402
import cv2  # noqa: E402
import numpy as np  # noqa: E402
from mathutils import Matrix, Vector  # noqa: E402
from tractrix_dataset import labels, plan, scene  # noqa: E402
from tractrix_dataset.flight import _look_at  # noqa: E402
from tractrix_dataset.render import RenderOptions, render_frame, set_up  # noqa: E402
from tractrix_dataset.scenarios import NAMES  # noqa: E402
from tractrix_dataset.scene import Request, build_world  # noqa: E402
from tractrix_dataset.seeds import rng  # noqa: E402
from tractrix_dataset.vehicles.assemble import assemble  # noqa: E402
from tractrix_dataset.vehicles.heavy import FLEET  # noqa: E402

FIRST_LABEL, MAX_VEHICLES = 10, 60
# Never rendered for training: measures how the network generalizes to an unseen body.
HELD_OUT = ("smart",)
EXTRA_VEHICLES = 14


def vehicle_names() -> list[str]:
    """Vehicles that may be seen in training."""
    return [name for name in sorted(FLEET) if name not in HELD_OUT]


def random_paint(r: np.random.Generator) -> tuple[float, float, float]:
    """A linear color: half of them gray scale from black to white, as real cars are."""
    value = float(r.uniform(0.0, 0.95) ** 1.8) + 0.008
    if r.random() < 0.5:
        return (value, value * r.uniform(0.95, 1.05), value * r.uniform(0.9, 1.1))
    color = r.uniform(0, 1, 3) ** 2
    return tuple(float(c) for c in 0.01 + color / color.max() * r.uniform(0.05, 0.8))


def add_vehicles(center: np.ndarray, heading: float, taken: list[np.ndarray], r: np.random.Generator) -> list:
    """Places vehicles of random kind and paint around a point; neighbors may be close side by side."""
    roots = []
    for k in range(EXTRA_VEHICLES):
        name = vehicle_names()[int(r.integers(len(vehicle_names())))]
        spec = replace(FLEET[name], paint=random_paint(r), plate_text=f"TX {k} R", text="")
        for _ in range(30):
            along, across = r.uniform(-28, 28), r.choice([-1.0, 1.0]) * r.uniform(2.6, 14)
            turn = heading + r.choice([0.0, np.pi]) + r.normal(0, 0.12) if r.random() < 0.8 else r.uniform(0, 2 * np.pi)
            ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
            at = center + along * ahead + across * left
            reach = spec.length / 2 + 1.2
            if all(np.hypot(*(at - other[:2])) > (reach + other[2]) * r.uniform(0.55, 1.0) for other in taken):
                break
        else:
            continue
        taken.append(np.array([*at, reach]))
        matrix = np.eye(4)
        x, y = at[:1], at[1:]
        matrix[:3, 3] = (*at, float(plan.surface_height(x, y)[0]))
        matrix[:3, :3] = scene._on_slope(tuple(at), np.array([np.cos(turn), np.sin(turn)]))
        vehicle = assemble(spec, 0)
        vehicle.root.matrix_world = Matrix(matrix.tolist())
        roots.append(vehicle.root)
    return roots


def label_vehicles(keep_out: tuple[str, ...]) -> dict[int, bpy.types.Object]:
    """Gives every vehicle a label of its own; removes vehicles that are held out."""
    found = {}
    for root in [o for o in bpy.data.objects if o.name.startswith("vehicle_")]:
        parts = list(root.children)
        if any(root.name.startswith(f"vehicle_{name}") for name in keep_out) or len(found) >= MAX_VEHICLES:
            for thing in (*parts, root):
                bpy.data.objects.remove(thing)
            continue
        label = FIRST_LABEL + len(found)
        for thing in (*parts, root):
            thing.pass_index = label
        found[label] = root
    return found


def visible_points(camera: np.ndarray, root: bpy.types.Object, length: float) -> int:
    """Number of five points of a vehicle that the camera sees."""
    graph = bpy.context.evaluated_depsgraph_get()
    count = 0
    for along, up in ((0, 0.9), (0.4, 0.7), (-0.4, 0.7), (0.2, 1.0), (-0.2, 1.0)):
        point = np.array(root.matrix_world @ Vector((along * length, 0, up)))
        toward = point - camera
        hit, _, _, _, thing, _ = bpy.context.scene.ray_cast(
            graph, Vector(camera), Vector(toward / np.linalg.norm(toward))
        )
        count += hit and thing is not None and thing.parent == root
    return count


def aim(roots: list[bpy.types.Object], r: np.random.Generator, width: int) -> tuple[np.ndarray, float] | None:
    """A camera pose and a focal length (px) that show one of the vehicles; none if everything is occluded."""
    for _ in range(40):
        root = roots[int(r.integers(len(roots)))]
        middle = np.array(root.matrix_world.translation) + [0, 0, 0.8]
        length = next(s.length for n, s in FLEET.items() if root.name.startswith(f"vehicle_{n}"))
        azimuth = r.uniform(0, 2 * np.pi)
        low = r.random() < 0.22
        elevation = np.radians(r.uniform(1, 12) if low else r.uniform(12, 75))
        focal = width * (r.uniform(0.5, 0.9) if low else r.uniform(0.7, 1.6))
        size_px = np.exp(r.uniform(np.log(45), np.log(190)))
        distance = max(focal * length / size_px, 5.0 + length / 2)
        away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        camera = middle + distance * away
        ground = float(plan.surface_height(camera[:1], camera[1:2])[0])
        camera[2] = max(camera[2], ground + 1.2)
        if visible_points(camera, root, length) < 2:
            continue
        aside = np.linalg.norm(camera - middle) * np.array([*r.uniform(-0.28, 0.28, 2), r.uniform(-0.12, 0.12)])
        aside *= width / focal
        return _look_at(camera, middle + aside, np.radians(r.normal(0, 3))), focal
    return None


def light(r: np.random.Generator) -> None:
    """Another sun: direction, strength and color; at times an overcast sky."""
    lamp = bpy.data.objects["sun"]
    lamp.rotation_euler = (np.radians(90 - r.uniform(14, 75)), 0.0, r.uniform(0, 2 * np.pi))
    overcast = r.random() < 0.25
    lamp.data.energy = r.uniform(0.0, 0.6) if overcast else r.uniform(2.0, 5.0)
    lamp.data.color = (1.0, r.uniform(0.85, 1.0), r.uniform(0.7, 1.0))
    background = next(n for n in bpy.context.scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = r.uniform(1.2, 2.2) if overcast else r.uniform(0.6, 1.2)


def render_scene(seed: int, frames: int, options: RenderOptions, output: Path) -> None:
    """Renders the missing frames of one scene."""
    missing = [f for f in range(frames) if not (output / f"{seed:04d}_{f:02d}.png").is_file()]
    if not missing:
        return
    r = rng("box-masks", seed)
    names = vehicle_names()
    streets = [name for name in NAMES if name != "bridge"]
    request = Request(streets[seed % len(streets)], names[int(r.integers(len(names)))], seed, 8)
    started = time.monotonic()
    world = build_world(request)
    scratch = output / "work"
    scratch.mkdir(exist_ok=True)
    set_up(world, options, scratch)
    scene.pose_frame(world, 4)
    pose = world.motion.world_from_object[4]
    heading = float(np.arctan2(pose[1, 0], pose[0, 0]))
    taken = [np.array([*m.world_from_object[4][:2, 3], 4.0]) for _, m in [(world.target, world.motion), *world.others]]
    added = add_vehicles(pose[:2, 3], heading, taken, r)
    bpy.context.view_layer.update()
    found = label_vehicles(HELD_OUT)
    near = [o for o in found.values() if np.hypot(*(np.array(o.matrix_world.translation)[:2] - pose[:2, 3])) < 45]
    print(
        f"scene {seed}: {request.name}, {len(found)} vehicles, {len(added)} added, {time.monotonic() - started:.0f} s",
        flush=True,
    )
    lens = bpy.context.scene.camera.data
    for frame in missing:
        r = rng("box-masks", seed, frame)
        aimed = aim(near, r, options.width)
        if aimed is None:
            continue
        light(r)
        lens.lens = 36.0 * aimed[1] / options.width
        world.camera.world_from_camera[4] = aimed[0]
        stem = output / f"{seed:04d}_{frame:02d}"
        image = scratch / "image.png"
        render_instances(world, image, stem.with_suffix(".png"), scratch)
        cv2.imwrite(str(stem.with_suffix(".jpg")), cv2.imread(str(image)), [cv2.IMWRITE_JPEG_QUALITY, 96])
    print(f"scene {seed}: done after {time.monotonic() - started:.0f} s", flush=True)


def render_instances(world: scene.World, image: Path, mask: Path, scratch: Path) -> None:
    """Renders frame 4 of a world; writes the vehicles' labels."""
    render_frame(world, 4, image, mask, scratch)
    found = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE)
    labels.write_png(mask, np.where(found >= FIRST_LABEL, found, 0).astype(np.uint8))


def main() -> None:
    """Reads the arguments and renders."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--frames", type=int, default=12, help="frames of a scene")
    parser.add_argument("--samples", type=int, default=2)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    options = RenderOptions(960, 540, arguments.samples, 1)
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.scenes):
        render_scene(seed, arguments.frames, options, arguments.output)


if __name__ == "__main__":
    main()
