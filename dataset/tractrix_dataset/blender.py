"""From numpy meshes to Blender objects."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from mathutils import Matrix

from .mesh import Mesh

GetMaterial = Callable[[str], bpy.types.Material]


def reset() -> None:
    """An empty file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def mesh_data(name: str, mesh: Mesh, get: GetMaterial, sharp_angle: float = 0.6) -> bpy.types.Mesh:
    """Blender mesh data with material slots, attributes and (if smooth) sharp edges by angle."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.faces)
    names = list(dict.fromkeys(mesh.materials))
    for material in names:
        data.materials.append(get(material))
    slot = {material: i for i, material in enumerate(names)}
    data.polygons.foreach_set("material_index", np.array([slot[m] for m in mesh.materials], np.int32))
    _attributes(data, mesh.attributes)
    if mesh.smooth:
        data.shade_smooth()
        data.set_sharp_from_angle(angle=sharp_angle)
    return data


def _attributes(data: bpy.types.Mesh, attributes: dict[str, np.ndarray]) -> None:
    """Adds attributes: (N,) numbers per vertex, or (F, 3) colours per face."""
    for name, values in attributes.items():
        if values.ndim == 1:
            data.attributes.new(name, "FLOAT", "POINT").data.foreach_set("value", values.astype(np.float32))
        else:
            rgba = np.column_stack([values, np.ones(len(values))]).astype(np.float32)
            data.attributes.new(name, "FLOAT_COLOR", "FACE").data.foreach_set("color", rgba.ravel())


def triangle_data(
    name: str,
    vertices: np.ndarray,
    triangles: np.ndarray,
    material: np.ndarray,
    names: tuple[str, ...],
    get: GetMaterial,
    attributes: dict[str, np.ndarray],
) -> bpy.types.Mesh:
    """Blender mesh data of many triangles, without a detour over Python lists."""
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(vertices))
    data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    data.loops.add(3 * len(triangles))
    data.loops.foreach_set("vertex_index", triangles.astype(np.int32).ravel())
    data.polygons.add(len(triangles))
    data.polygons.foreach_set("loop_start", np.arange(0, 3 * len(triangles), 3, dtype=np.int32))
    for entry in names:
        data.materials.append(get(entry))
    data.update(calc_edges=True)
    data.polygons.foreach_set("material_index", material.astype(np.int32))
    _attributes(data, attributes)
    return data


def place(
    name: str, data: bpy.types.ID, label: int, matrix: np.ndarray | None = None, parent: bpy.types.Object | None = None
) -> bpy.types.Object:
    """An object in the scene; ``label`` is what the label maps say where it is seen."""
    made = bpy.data.objects.new(name, data)
    made.pass_index = label
    bpy.context.scene.collection.objects.link(made)
    if parent is not None:
        made.parent = parent
    if matrix is not None:
        made.matrix_world = Matrix(matrix.tolist())
    return made


def float_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """A linear image (H, W, 3), first row at the bottom."""
    height, width, _ = pixels.shape
    image = bpy.data.images.new(name, width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    rgba = np.concatenate([pixels, np.ones((height, width, 1))], 2).astype(np.float32)
    image.pixels.foreach_set(rgba.ravel())
    return image


def evaluated(thing: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, 3) in object space and triangles (M, 3), modifiers applied."""
    graph = bpy.context.evaluated_depsgraph_get()
    owner = thing.evaluated_get(graph)
    data = owner.to_mesh()
    data.calc_loop_triangles()
    vertices = np.zeros(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", vertices)
    triangles = np.zeros(3 * len(data.loop_triangles), np.int32)
    data.loop_triangles.foreach_get("vertices", triangles)
    owner.to_mesh_clear()
    return vertices.reshape(-1, 3).astype(float), triangles.reshape(-1, 3).astype(np.int64)


def decimated(vertices: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A surface with at most about ``count`` triangles; flat parts lose theirs first."""
    data = triangle_data("whole", vertices, triangles, np.zeros(len(triangles)), (), lambda _: None, {})
    thing = place("whole", data, 0)
    modifier = thing.modifiers.new("fewer", "DECIMATE")
    modifier.ratio = min(1.0, count / max(1, len(triangles)))
    fewer = evaluated(thing)
    bpy.data.objects.remove(thing)
    bpy.data.meshes.remove(data)
    return fewer
