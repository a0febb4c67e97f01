"""A vehicle in Blender: shell with wheel arches, livery, fittings, four wheels on pivots."""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

from .. import blender
from ..mesh import Mesh, MeshBuilder
from ..shading import Nodes, Socket, material
from . import body, heavy_livery, heavy_parts, livery, parts
from .heavy import Block, HeavySpec
from .spec import VehicleSpec

GROUND_TRUTH_TRIANGLES = 7000
EDGE_SEGMENTS = 4

Spec = VehicleSpec | HeavySpec


@dataclass
class Vehicle:
    """A vehicle's objects. ``root`` carries the pose; wheels are its children."""

    spec: Spec
    root: bpy.types.Object
    shell: bpy.types.Object
    fittings: bpy.types.Object
    wheels: list[bpy.types.Object]


def _image(name: str, picture: object, color: bool) -> bpy.types.Image:
    """A PIL picture as a Blender image, made once per name."""
    if name in bpy.data.images:
        return bpy.data.images[name]
    pixels = np.asarray(picture.convert("RGBA"), np.float32)[::-1] / 255.0
    image = bpy.data.images.new(name, picture.width, picture.height, alpha=True)
    image.colorspace_settings.name = "sRGB" if color else "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(np.ascontiguousarray(pixels).ravel())
    return image


def _look_up(n: Nodes, spec: Spec, view: str, canvas: livery.Canvas, u: Socket, v: Socket) -> tuple:
    """Colour, alpha and finish of one picture at plane coordinates."""
    size = canvas.high - canvas.low
    uv = n.combine(
        n.math("DIVIDE", n.math("SUBTRACT", u, canvas.low[0]), size[0]),
        n.math("DIVIDE", n.math("SUBTRACT", v, canvas.low[1]), size[1]),
    )
    color, finish = canvas.finished()
    samples = []
    for suffix, picture, is_color in (("color", color, True), ("finish", finish, False)):
        image = _image(f"{spec.name}_{spec.plate_text}_{view}_{suffix}", picture, is_color)
        samples.append(n.node("ShaderNodeTexImage", {0: uv}, image=image, extension="EXTEND"))
    return samples[0].outputs["Color"], samples[0].outputs["Alpha"], samples[1].outputs["Color"]


def _chosen(n: Nodes, spec: Spec) -> tuple[Socket, Socket, Socket]:
    """Colour, alpha and finish of the picture that faces the surface."""
    x, y, z = n.separate(n.position())
    nx, ny, _ = n.separate(n.position("Normal"))
    pictures = heavy_livery.paint(spec) if isinstance(spec, HeavySpec) else livery.paint(spec)
    plane = {"top": (x, y), "front": (y, z), "rear": (y, z), "left": (x, z), "right": (x, z)}
    sample = {view: _look_up(n, spec, view, pictures[view], *plane[view]) for view in plane}
    color, alpha, finish = sample["top"]
    tests = {
        "front": n.math("GREATER_THAN", nx, 0.33),
        "rear": n.math("LESS_THAN", nx, -0.33),
        "left": n.math("GREATER_THAN", ny, 0.60),
        "right": n.math("LESS_THAN", ny, -0.60),
    }
    for view, test in tests.items():
        color = n.mix(color, sample[view][0], test)
        alpha = n.lerp(alpha, sample[view][1], test)
        finish = n.mix(finish, sample[view][2], test)
    return color, alpha, finish


def _dirty(n: Nodes, color: Socket) -> Socket:
    """Road dirt, most of it low down, fixed to the car."""
    at = n.position()
    _, _, z = n.separate(at)
    splash = n.math("MULTIPLY", n.step(z, 0.75, 0.15), n.step(n.noise(at, 4.0, 6.0, 0.65), 0.38, 0.72))
    film = n.math("MULTIPLY", n.step(n.noise(at, 1.6, 6.0, 0.7), 0.42, 0.75), 0.16)
    return n.mix(color, (0.17, 0.145, 0.11), n.math("ADD", n.math("MULTIPLY", splash, 0.55), film, clamp=True))


def _look(spec: Spec) -> str:
    """A name for model, plate and paint together."""
    return f"{spec.name}_{spec.plate_text}_{spec.paint}"


def _body_material(spec: Spec) -> bpy.types.Material:
    """Paint under a clear coat, with the livery on it."""

    def build(n: Nodes) -> None:
        color, alpha, finish = _chosen(n, spec)
        parts_of_finish = n.node("ShaderNodeSeparateColor", {0: finish}).outputs
        base = n.mix(spec.paint, color, alpha)
        rough = n.lerp(0.28, parts_of_finish[0], alpha)
        metal = n.lerp(0.0, parts_of_finish[1], alpha)
        coat = n.math("MULTIPLY", n.math("SUBTRACT", 1.0, alpha), spec.coat)
        n.surface(_dirty(n, base), rough, metal, coat, specular=0.5, distant=spec.paint)

    return material(f"body_{_look(spec)}", build)


def _part_material(spec: Spec, name: str) -> bpy.types.Material:
    """The materials of fittings and wheels."""
    looks = {
        "tyre": ((0.018, 0.018, 0.018), 0.85, 0.0),
        "rim": ((0.42, 0.43, 0.44), 0.35, 0.7),
        "brake": ((0.035, 0.033, 0.03), 0.7, 0.2),
        "trim": ((0.02, 0.02, 0.02), 0.5, 0.0),
        "chrome": ((0.6, 0.6, 0.62), 0.2, 0.9),
        "well": ((0.008, 0.008, 0.008), 0.95, 0.0),
    }
    if name == "paint_plain":
        return material(f"plain_{_look(spec)}", lambda n: n.surface(spec.paint, 0.28, 0.0, spec.coat))
    color, roughness, metallic = looks[name]
    return material(f"part_{name}", lambda n: n.surface(color, roughness, metallic))


def _cutters(spec: Spec) -> Mesh:
    """Four cylinders that cut the wheel arches out of the shell."""
    builder = MeshBuilder()
    radius, inner, outer = spec.arch_radius, spec.track_half - spec.tyre_width - 0.07, spec.width / 2 + 0.2
    angles = np.linspace(0, 2 * np.pi, 56, endpoint=False)
    for axle in spec.axles:
        for sign in (-1, 1):
            low, high = sorted((sign * inner, sign * outer))
            ring = np.stack([axle + radius * np.cos(angles), spec.wheel_radius + radius * np.sin(angles)], 1)
            points = np.vstack([np.column_stack([ring[:, 0], np.full(56, y), ring[:, 1]]) for y in (low, high)])
            faces = [(j, (j + 1) % 56, 56 + (j + 1) % 56, 56 + j) for j in range(56)]
            faces = [tuple(reversed(f)) for f in faces]
            builder.add(points, [*faces, tuple(range(56)), tuple(range(111, 55, -1))], "well")
    return builder.mesh()


def _lofted(spec: VehicleSpec) -> Mesh:
    """The closed shell of a car."""
    points, quads = body.build_shell(spec)
    tail, nose = body.end_loops(len(points))
    faces = [tuple(q) for q in quads.tolist()] + [tuple(tail.tolist()), tuple(nose.tolist())]
    return Mesh(points, faces, [])


def _solid(mesh: Mesh) -> bpy.types.Object:
    """A closed mesh as an object with outward normals."""
    solid = blender.place("solid", blender.mesh_data("solid", mesh, lambda _: None), 0)
    _orient(solid.data)
    return solid


def _cut(spec: Spec, solid: bpy.types.Object) -> None:
    """Cuts the wheel arches out of a solid."""
    tool = blender.place("tool", blender.mesh_data("tool", _cutters(spec), lambda _: _part_material(spec, "well")), 0)
    _orient(tool.data)
    modifier = solid.modifiers.new("arches", "BOOLEAN")
    modifier.object, modifier.operation, modifier.solver = tool, "DIFFERENCE", "EXACT"


def _baked(solid: bpy.types.Object) -> bpy.types.Mesh:
    """Mesh data with all modifiers applied; the solid and its tools are removed."""
    tools = [m.object for m in solid.modifiers if m.type == "BOOLEAN"]
    graph = bpy.context.evaluated_depsgraph_get()
    data = bpy.data.meshes.new_from_object(solid.evaluated_get(graph))
    for thing in (solid, *tools):
        bpy.data.objects.remove(thing)
    return data


def _rounded_block(spec: HeavySpec, block: Block) -> bpy.types.Mesh:
    """Mesh data of a block with round edges and, where it has them, arches."""
    solid = _solid(block.mesh())
    bevel = solid.modifiers.new("edges", "BEVEL")
    bevel.width, bevel.segments, bevel.limit_method = block.edge, EDGE_SEGMENTS, "ANGLE"
    bevel.angle_limit = np.radians(20)
    if block.has_arches:
        _cut(spec, solid)
    return _baked(solid)


def _joined_blocks(spec: HeavySpec) -> bpy.types.Mesh:
    """Mesh data of all blocks of a body together."""
    work = bmesh.new()
    for block in spec.blocks:
        piece = _rounded_block(spec, block)
        work.from_mesh(piece)
        bpy.data.meshes.remove(piece)
    data = bpy.data.meshes.new("shell")
    work.to_mesh(data)
    work.free()
    return data


def _cut_shell(spec: Spec) -> bpy.types.Mesh:
    """Mesh data of the shell with its arches; inner faces are dark."""
    if isinstance(spec, HeavySpec):
        data = _joined_blocks(spec)
    else:
        solid = _solid(_lofted(spec))
        _cut(spec, solid)
        data = _baked(solid)
    _finish_shell(spec, data)
    return data


def _orient(data: bpy.types.Mesh) -> None:
    """Makes all normals point outward."""
    work = bmesh.new()
    work.from_mesh(data)
    bmesh.ops.recalc_face_normals(work, faces=work.faces)
    work.to_mesh(data)
    work.free()


def _finish_shell(spec: Spec, data: bpy.types.Mesh) -> None:
    """Material slots by place (0 outside, 1 inside an arch) and smooth shading with sharp edges."""
    centers = np.zeros(3 * len(data.polygons), np.float32)
    data.polygons.foreach_get("center", centers)
    x, y, z = centers.reshape(-1, 3).T
    inside = np.zeros(len(x), bool)
    for axle in spec.axles:
        inside |= np.hypot(x - axle, z - spec.wheel_radius) < spec.arch_radius + 0.002
    inside &= np.abs(y) < spec.width / 2 + 0.05
    data.polygons.foreach_set("material_index", inside.astype(np.int32))
    data.shade_smooth()
    data.set_sharp_from_angle(angle=0.75)


def _painted_shell(spec: Spec) -> bpy.types.Mesh:
    """The shell's mesh data with this vehicle's own paint."""
    data = _shared(f"shell_{spec.name}", lambda: _cut_shell(spec)).copy()
    slots = np.zeros(len(data.polygons), np.int32)
    data.polygons.foreach_get("material_index", slots)
    data.materials.clear()
    data.materials.append(_body_material(spec))
    data.materials.append(_part_material(spec, "well"))
    data.polygons.foreach_set("material_index", slots)
    return data


def assemble(spec: Spec, label: int) -> Vehicle:
    """Builds a vehicle at the world's origin; ``label`` goes into the label maps."""
    root = blender.place(f"vehicle_{spec.name}", None, label)
    shell = blender.place("shell", _shared(f"shell_{_look(spec)}", lambda: _painted_shell(spec)), label, parent=root)
    get = lambda name: _part_material(spec, name)  # noqa: E731
    bolted = heavy_parts.build_fittings if isinstance(spec, HeavySpec) else parts.build_fittings
    fittings_data = _shared(
        f"fittings_{_look(spec)}", lambda: blender.mesh_data("fittings", _smooth(bolted(spec)), get)
    )
    fittings = blender.place("fittings", fittings_data, label, parent=root)
    wheel_data = _shared(
        f"wheel_{spec.name}", lambda: blender.mesh_data("wheel", _smooth(parts.build_wheel(spec)), get)
    )
    wheels = [blender.place("wheel", wheel_data, label, parent=root) for _ in range(4)]
    vehicle = Vehicle(spec, root, shell, fittings, wheels)
    pose_wheels(vehicle, np.zeros(4), 0.0, 0.0)
    return vehicle


def _smooth(mesh: Mesh) -> Mesh:
    mesh.smooth = True
    return mesh


def _shared(name: str, build: object) -> bpy.types.Mesh:
    """Mesh data of that name, built once."""
    found = bpy.data.meshes.get(name)
    if found is None:
        found = build()
        found.name = name
    return found


def pose_wheels(vehicle: Vehicle, lift: np.ndarray, spin: float, steer: float) -> None:
    """Moves the wheels up by ``lift`` (4, metres), turns them by ``spin`` and ``steer`` (radians)."""
    for i, (wheel, center) in enumerate(zip(vehicle.wheels, parts.wheel_centers(vehicle.spec))):
        outside = 0.0 if center[1] > 0 else np.pi
        angle = outside + (steer if i >= 2 else 0.0)
        turn = spin if center[1] > 0 else -spin
        c, s = np.cos(angle), np.sin(angle)
        about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        c, s = np.cos(turn), np.sin(turn)
        about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        matrix = np.eye(4)
        matrix[:3, :3] = about_z @ about_y
        matrix[:3, 3] = center + [0, 0, lift[i]]
        wheel.matrix_basis = Matrix(matrix.tolist())


def ground_truth_mesh(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """The whole vehicle with wheels at rest: vertices (N, 3) in object coordinates, triangles."""
    pose_wheels(vehicle, np.zeros(4), 0.0, 0.0)
    bpy.context.view_layer.update()
    shell_share = _decimated(vehicle.shell)
    pieces = [shell_share, blender.evaluated(vehicle.fittings)]
    for wheel in vehicle.wheels:
        vertices, triangles = blender.evaluated(wheel)
        matrix = np.array(wheel.matrix_basis)
        pieces.append((vertices @ matrix[:3, :3].T + matrix[:3, 3], triangles))
    offsets = np.cumsum([0] + [len(v) for v, _ in pieces[:-1]])
    return np.vstack([v for v, _ in pieces]), np.vstack([t + o for (_, t), o in zip(pieces, offsets)])


def _decimated(shell: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """The shell with fewer triangles (flat parts merged; errors of millimetres)."""
    full = blender.evaluated(shell)
    modifier = shell.modifiers.new("fewer", "DECIMATE")
    modifier.ratio = min(1.0, GROUND_TRUTH_TRIANGLES / len(full[1]))
    fewer = blender.evaluated(shell)
    shell.modifiers.remove(modifier)
    return fewer
