#!/usr/bin/env python3
"""Writes the data set's vehicles as plain arrays for `synthesize.py`: triangles, normals, materials, liveries.

python export_vehicles.py OUTPUT.npz                 # Python 3.11 with dataset/requirements.txt
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "dataset"))

import bpy  # noqa: E402
import numpy as np  # noqa: E402
from render_frames import vehicle_names  # noqa: E402
from tractrix_dataset import blender  # noqa: E402
from tractrix_dataset.vehicles import heavy_livery, livery  # noqa: E402
from tractrix_dataset.vehicles.assemble import assemble  # noqa: E402
from tractrix_dataset.vehicles.heavy import FLEET, HeavySpec  # noqa: E402

MATERIALS = ("body", "plain", "tyre", "rim", "brake", "trim", "chrome", "well")
VIEWS = ("top", "front", "rear", "left", "right")


def triangles(thing: bpy.types.Object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (n, 3, 3) and normals (n, 3, 3) in the vehicle's coordinates, and materials (n)."""
    graph = bpy.context.evaluated_depsgraph_get()
    owner = thing.evaluated_get(graph)
    data = owner.to_mesh()
    data.calc_loop_triangles()
    count = len(data.loop_triangles)
    vertices = np.zeros(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", vertices)
    indices, normals, slots = np.zeros(3 * count, np.int32), np.zeros(9 * count, np.float32), np.zeros(count, np.int32)
    data.loop_triangles.foreach_get("vertices", indices)
    data.loop_triangles.foreach_get("split_normals", normals)
    data.loop_triangles.foreach_get("material_index", slots)
    names = [(m.name.split("_")[1] if m.name.startswith("part_") else m.name.split("_")[0]) for m in data.materials]
    materials = np.array([MATERIALS.index(name) for name in names], np.uint8)[slots]
    owner.to_mesh_clear()
    pose = np.array(thing.matrix_basis)
    corners = vertices.reshape(-1, 3)[indices.reshape(-1, 3)] @ pose[:3, :3].T + pose[:3, 3]
    return corners, normals.reshape(-1, 3, 3) @ pose[:3, :3].T, materials


def main() -> None:
    """Writes all vehicles that may be seen in training."""
    content = {"names": np.array(vehicle_names())}
    for name in vehicle_names():
        blender.reset()
        spec = FLEET[name]
        vehicle = assemble(spec, 1)
        bpy.context.view_layer.update()
        parts = [triangles(thing) for thing in (vehicle.shell, vehicle.fittings, *vehicle.wheels)]
        for k, what in enumerate(("corners", "normals", "materials")):
            values = np.concatenate([part[k] for part in parts])
            content[f"{name}_{what}"] = values if values.dtype == np.uint8 else values.astype(np.float16)
        pictures = heavy_livery.paint(spec) if isinstance(spec, HeavySpec) else livery.paint(spec)
        for view in VIEWS:
            color, finish = pictures[view].finished()
            scale = min(1.0, 640 / max(color.size))
            size = tuple(max(2, round(s * scale)) for s in color.size)
            content[f"{name}_{view}"] = np.asarray(color.convert("RGBA").resize(size))
            content[f"{name}_{view}_finish"] = np.asarray(finish.convert("RGB").resize(size))[..., 0]
            content[f"{name}_{view}_area"] = np.concatenate([pictures[view].low, pictures[view].high])
        content[f"{name}_size"] = np.array([spec.length, spec.width])
        print(name, len(content[f"{name}_materials"]), "triangles", flush=True)
    np.savez_compressed(sys.argv[1], **content)


if __name__ == "__main__":
    main()
