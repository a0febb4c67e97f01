"""Puts a sequence's world together in Blender: ground, houses, things, light, vehicles."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from . import blender, buildings, flight, furniture, materials, nature, plan
from .drives import Dashcam, Trajectory, focus_of_all, frame_times
from .flight import CameraPath
from .ground import MATERIALS, Focus, Ground, build_deck, build_ground
from .kinematics import Motion, Probe, simulate
from .labels import GROUND, OTHER, STATIC, TARGET
from .markings import build_litter, build_markings
from .mesh import Mesh, MeshBuilder
from .scenarios import trajectory as trajectory_of
from .seeds import Key, fbm, rng, smoothstep
from .shading import Nodes
from .vehicles.assemble import Vehicle, assemble, pose_wheels
from .vehicles.heavy import FLEET
from .vehicles.spec import VEHICLES, VehicleSpec, repainted

HOST = "saloon"
SMOOTH = {"road": "smooth_road", "deck": "smooth_road"}
LOT_REACH_M, PLACE_REACH_M, TREE_REACH_M = 95.0, 70.0, 120.0
MIN_VIEW_GAP_M = 0.35


@dataclass(frozen=True)
class Request:
    """Which sequence: names, seed, number of frames."""

    trajectory: str
    vehicle: str
    seed: int
    n_frames: int

    @property
    def key(self) -> tuple[Key, ...]:
        """The sequence's key for seeded randomness."""
        return (self.trajectory, self.vehicle, self.seed)

    @property
    def name(self) -> str:
        """The sequence's name."""
        return f"{self.trajectory}_{self.vehicle}" + (f"_{self.seed}" if self.seed else "")


@dataclass
class Parked:
    """A parked car: its model, and its pose in the world (4, 4)."""

    spec: VehicleSpec
    world_from_object: np.ndarray


@dataclass
class World:
    """A sequence ready to be rendered, with all that is known about it."""

    request: Request
    trajectory: Trajectory
    times: np.ndarray
    target: Vehicle
    motion: Motion
    others: list[tuple[Vehicle, Motion]]
    parked: list[Parked]
    camera: CameraPath
    grounds: list[Ground]
    focus: Focus


def _place_ground(grounds: list[Ground], asphalt: str) -> None:
    names = tuple(SMOOTH.get(m, m) if asphalt == "smooth" else m for m in MATERIALS)
    for i, ground in enumerate(grounds):
        data = blender.triangle_data(
            f"ground_{i}",
            ground.vertices,
            ground.triangles,
            ground.material,
            names,
            materials.get,
            {"kerb": ground.kerb},
        )
        blender.place(f"ground_{i}", data, GROUND)


def _place_mesh(name: str, mesh: Mesh, label: int, matrix: np.ndarray | None = None) -> None:
    if mesh.faces:
        blender.place(name, blender.mesh_data(name, mesh, materials.get), label, matrix)


def _sign_text(frame: np.ndarray, words: str) -> None:
    """Raised letters on a shop's sign board."""
    curve = bpy.data.curves.new("sign", "FONT")
    curve.body, curve.size, curve.extrude, curve.align_x = words, 0.46, 0.012, "CENTER"
    letters = bpy.data.objects.new("letters", curve)
    bpy.context.scene.collection.objects.link(letters)
    upright = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    letters.matrix_world = Matrix((frame @ upright).tolist())
    letters.pass_index = STATIC
    curve.materials.append(materials.get("white"))


def _place_houses(lots: list[buildings.Lot], focus: Focus) -> None:
    for lot in lots:
        if focus.distance(*lot.front[:, None])[0] > LOT_REACH_M:
            continue
        house = buildings.build_house(lot)
        _place_mesh("house", house.mesh, STATIC)
        if house.sign is not None:
            _sign_text(*house.sign)


def _thing_data(kind: str, variant_number: int) -> bpy.types.Mesh:
    """Mesh data of a kind of thing, shared by all of its instances."""
    if kind == "tree":
        variant_number %= nature.N_TREE_KINDS
    elif kind == "bush":
        variant_number %= nature.N_BUSH_KINDS
    name = f"{kind}_{variant_number}"
    found = bpy.data.meshes.get(name)
    if found is None:
        build = {"tree": nature.build_tree, "bush": nature.build_bush}.get(kind)
        mesh = build(variant_number) if build else furniture.build(kind, variant_number)
        found = blender.mesh_data(name, mesh, materials.get)
    return found


def _place_things(places: list[furniture.Place], focus: Focus) -> list[Parked]:
    """Places what is near, and gives the parked cars among it."""
    parked = []
    x, y = np.array([p.position for p in places]).T
    for place, away, z in zip(places, focus.distance(x, y), plan.surface_height(x, y)):
        if away > (TREE_REACH_M if place.kind == "tree" else PLACE_REACH_M):
            continue
        if place.kind == "parked":
            parked.append(_park(place, place.matrix(z)))
        else:
            blender.place(place.kind, _thing_data(place.kind, place.variant), STATIC, place.matrix(z))
    return parked


def _park(place: furniture.Place, matrix: np.ndarray) -> Parked:
    """A parked car: one of the five models in one of a few paints."""
    names = sorted(VEHICLES)
    spec = repainted(VEHICLES[names[place.variant % 5]], place.variant // 5, f"TX {100 + place.variant % 5} P")
    car = assemble(spec, STATIC)
    matrix[:3, :3] = _on_slope(place.position, np.array([np.cos(place.heading), np.sin(place.heading)]))
    car.root.matrix_world = Matrix(matrix.tolist())
    return Parked(spec, matrix)


def _on_slope(position: tuple[float, float], forward: np.ndarray) -> np.ndarray:
    """Rotation of something that stands on the base ground with this heading."""
    x, y = position
    rise = [
        float(plan.road_height(*(p := np.array([[x], [y]]) + step[:, None]), plan.survey(*p))[0])
        for step in (
            forward,
            -forward,
            np.array([-forward[1], forward[0]]) * 0.6,
            np.array([forward[1], -forward[0]]) * 0.6,
        )
    ]
    ahead = np.array([*forward, (rise[0] - rise[1]) / 2])
    left = np.array([-forward[1], forward[0], (rise[2] - rise[3]) / 1.2])
    ahead /= np.linalg.norm(ahead)
    up = np.cross(ahead, left)
    up /= np.linalg.norm(up)
    return np.stack([ahead, np.cross(up, ahead), up], 1)


def _place_river(focus: Focus) -> None:
    """Water in the valley, and the bridge's piers and railings."""
    level = float(plan.base_height(np.array(plan.RIVER_X_M), np.array(120.0))) - plan.RIVER_DEPTH_M + 1.6
    builder = MeshBuilder()
    xs, ys = np.linspace(270, 390, 40), np.linspace(-499, 499, 200)
    for y0, y1 in zip(ys, ys[1:]):
        builder.strip(
            np.column_stack([xs, np.full(40, y0), np.full(40, level)]),
            np.column_stack([xs, np.full(40, y1), np.full(40, level)]),
            "water",
        )
    _place_mesh("river", builder.mesh(), STATIC)
    if focus.distance(np.array([plan.RIVER_X_M]), np.array([0.0]))[0] < 150:
        _place_mesh("bridge", _bridge_structure(), STATIC)


def _bridge_structure() -> Mesh:
    """Girders, piers, railings with posts."""
    builder = MeshBuilder()
    xs = np.arange(plan.BRIDGE_START_M - 1, plan.BRIDGE_END_M + 1.01, 1.0)
    top = plan.deck_height(xs, np.zeros(len(xs)))
    for side in (-1, 1):
        edge = np.full(len(xs), side * 7.4)
        upper, lower = np.column_stack([xs, edge, top + 0.16]), np.column_stack([xs, edge, top - 1.3])
        builder.strip(upper, lower, "concrete")
        builder.strip(lower, np.column_stack([xs, -0.9 * edge, top - 1.3]), "concrete")
        for lift, radius in ((1.15, 0.05), (0.75, 0.025), (0.45, 0.025)):
            builder.tube(
                np.column_stack([xs, side * np.full(len(xs), 7.25), top + lift]),
                radius,
                "rust" if lift > 1 else "steel",
                6,
            )
        for i, (x, z) in enumerate(zip(xs[::2], top[::2])):
            builder.box((x - 0.05, side * 7.25 - 0.05, z), (x + 0.05, side * 7.25 + 0.05, z + 1.2), "steel")
            r = rng("railing", i, side)
            if r.random() < 0.3:
                builder.box(
                    (x + 0.2, side * 7.2 - 0.01, z + 0.5),
                    (x + r.uniform(0.5, 1.4), side * 7.2 + 0.01, z + 1.0),
                    f"paint_{int(r.integers(10))}",
                )
    for x in (plan.RIVER_X_M - 14, plan.RIVER_X_M + 14):
        builder.box((x - 1.0, -5.5, -20), (x + 1.0, 5.5, float(np.interp(x, xs, top)) - 1.2), "concrete")
    return builder.mesh()


def _sky_picture(key: tuple[Key, ...]) -> np.ndarray:
    """An equirectangular sky (H, W, 3), linear: blue, haze at the horizon, clouds of its own for every key."""
    height, width = 256, 512
    azimuth = (np.arange(width) + 0.5) / width * 2 * np.pi
    elevation = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    up = np.sin(elevation)[:, None] * np.ones(width)
    flat = np.cos(elevation)[:, None] / (np.maximum(up, 0) + 0.12)
    x, y = flat * np.cos(azimuth), flat * np.sin(azimuth)
    cloud = smoothstep(fbm(x, y, 1.6, 6, "clouds", *key), 0.05, 0.75)[..., None] * 0.85
    at = np.clip((up + 0.1) / 1.1, 0, 1)
    stops = np.array([(0.62, 0.68, 0.74), (0.30, 0.45, 0.72), (0.14, 0.27, 0.58)])
    blue = np.stack([np.interp(at, (0.0, 0.5, 1.0), stops[:, k]) for k in range(3)], -1)
    return blue * (1 - cloud) + np.array([0.92, 0.93, 0.95]) * cloud


def _light(elevation_deg: float, azimuth_deg: float, key: tuple[Key, ...]) -> None:
    """Sun and sky."""
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle, sun.color = 3.6, np.radians(0.6), (1.0, 0.945, 0.86)
    lamp = bpy.data.objects.new("sun", sun)
    lamp.rotation_euler = (np.radians(90 - elevation_deg), 0.0, np.radians(azimuth_deg))
    bpy.context.scene.collection.objects.link(lamp)
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    n = Nodes(world)
    sky = n.node("ShaderNodeTexEnvironment", image=blender.float_image("sky", _sky_picture(key)))
    background = n.node("ShaderNodeBackground", {"Color": sky.outputs[0], "Strength": 1.0})
    n.node("ShaderNodeOutputWorld", {"Surface": background.outputs[0]})


def _choose_flight(trajectory: Trajectory, poses: np.ndarray, times: np.ndarray, key: tuple) -> tuple[CameraPath, list]:
    """The first azimuth that no house is in the way of, or the one with the fewest."""
    lots = list(buildings.lots())
    start = int(rng("azimuth", *key).integers(4))
    candidates = trajectory.flight.azimuths[start:] + trajectory.flight.azimuths[:start]
    best: tuple[CameraPath, list] | None = None
    for azimuth in candidates:
        camera = flight.fly(trajectory.flight, azimuth, poses, times, key)
        blocked = flight.lots_in_the_way(camera, poses, lots)
        if best is None or len(blocked) < len(best[1]):
            best = (camera, blocked)
        if not blocked:
            break
    return best


def _focus(trajectory: Trajectory, n_frames: int) -> Focus:
    """The part of the world that matters: the target's drive, with a dashcam all drives of its road."""
    seen = trajectory.drives if isinstance(trajectory.flight, Dashcam) else (trajectory.drive,)
    return focus_of_all(seen, n_frames)


def _camera(
    trajectory: Trajectory, poses: np.ndarray, times: np.ndarray, probe: Probe, key: tuple
) -> tuple[CameraPath, list]:
    """The camera's path, and the houses that have to go for it."""
    if not isinstance(trajectory.flight, Dashcam):
        return _choose_flight(trajectory, poses, times, key)
    host = simulate(VEHICLES[HOST], trajectory.flight.drive, times, probe)
    return flight.ride(trajectory.flight, host.world_from_object, times, key), []


def build_world(request: Request) -> World:
    """Everything of one sequence, placed in a fresh Blender file."""
    blender.reset()
    trajectory = trajectory_of(request.trajectory, request.vehicle, request.seed)
    times = frame_times(request.n_frames)
    focus = _focus(trajectory, request.n_frames)
    grounds = [build_ground(focus, trajectory.ground_step)]
    if focus.distance(np.array([plan.RIVER_X_M]), np.array([0.0]))[0] < 150:
        grounds.append(build_deck())
    probe = Probe(grounds, focus.low - 60, focus.high + 60)
    spec = FLEET[request.vehicle]
    motion = simulate(spec, trajectory.drive, times, probe)
    camera, blocked = _camera(trajectory, motion.world_from_object, times, probe, request.key)
    parked = _build_surroundings(grounds, focus, trajectory, camera, motion, blocked, request.key)
    target = assemble(spec, TARGET)
    others = []
    for i, (name, drive) in enumerate(trajectory.others):
        other = repainted(FLEET[name], int(rng("other", *request.key, i).integers(10)), f"TX {310 + 7 * i} Q")
        others.append((assemble(other, OTHER), simulate(other, drive, times, probe)))
    return World(request, trajectory, times, target, motion, others, parked, camera, grounds, focus)


def _build_surroundings(
    grounds: list[Ground],
    focus: Focus,
    trajectory: Trajectory,
    camera: CameraPath,
    motion: Motion,
    blocked: list,
    key: tuple[Key, ...],
) -> list[Parked]:
    """Places all that does not move, without what stands in the line of sight; gives the parked cars."""
    _place_ground(grounds, trajectory.asphalt)
    _place_houses([lot for lot in buildings.lots() if lot not in blocked], focus)
    everything = furniture.places()
    close = focus.distance(*np.array([p.position for p in everything]).T) < TREE_REACH_M
    near = [p for p, is_close in zip(everything, close) if is_close]
    parked = _place_things(_clear(near, trajectory, camera, motion), focus)
    worn = trajectory.asphalt == "worn"
    _place_mesh("markings", build_markings(focus, worn), GROUND)
    if worn:
        _place_mesh("litter", build_litter(focus), GROUND)
    _place_mesh("tufts", nature.build_tufts(focus), GROUND)
    _place_river(focus)
    _light(*trajectory.sun, key)
    return parked


def _clear(
    near: list[furniture.Place], trajectory: Trajectory, camera: CameraPath, motion: Motion
) -> list[furniture.Place]:
    """What may stand: nothing in a drone's line of sight but what is planted there on purpose."""
    if isinstance(trajectory.flight, Dashcam):
        return near
    hiding = set(flight.places_in_the_way(camera, motion.world_from_object, near, MIN_VIEW_GAP_M))
    planted = [furniture.planted(stand, plan.street(trajectory.drive.street)) for stand in trajectory.planted]
    return [p for p in near if p not in hiding and not _crowded(p, planted)] + planted


def _crowded(place: furniture.Place, planted: list[furniture.Place]) -> bool:
    """Whether something stands where another thing is planted."""
    return any(np.hypot(*np.subtract(place.position, p.position)) < place.radius + p.radius for p in planted)


def pose_frame(world: World, index: int) -> None:
    """Moves vehicles, wheels and camera to where they are in a frame."""
    for vehicle, motion in [(world.target, world.motion), *world.others]:
        vehicle.root.matrix_world = Matrix(motion.world_from_object[index].tolist())
        pose_wheels(vehicle, motion.lift[index], float(motion.spin[index]), float(motion.steer[index]))
    from_blender = np.diag([1.0, -1.0, -1.0, 1.0])
    bpy.context.scene.camera.matrix_world = Matrix((world.camera.world_from_camera[index] @ from_blender).tolist())
