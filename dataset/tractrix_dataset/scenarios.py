"""Harder sequences beside the seven: occlusion, leaving the picture, standing still, dashcams.

Every scenario is a function of the vehicle and of a random generator of its
own, so that each seed is another variant and the seven stay what they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .drives import TRAJECTORIES, Dashcam, Drive, Flight, Knots, Stand, Trajectory, variant
from .seeds import rng
from .vehicles.heavy import FLEET

LEFT_ABEAM = (90.0, 84.0, 96.0, 78.0, 102.0)
RIGHT_ABEAM = (-90.0, -84.0, -96.0, -78.0, -102.0)
ALL_ROUND = (140.0, -140.0, 110.0, -110.0, 70.0, -70.0, 40.0, -40.0, 165.0, -165.0)
STOP_LINE_M = 479.9
END_S = 6.0


def _steady(speed: float, ripple: float = 0.06) -> Knots:
    """About one speed, a little slower in the middle."""
    return ((0.0, speed), (2.8, speed * (1 - ripple)), (END_S, speed))


def _passing(target: Drive, faster: float, lane: float, at_s: float) -> Drive:
    """A drive in another lane of the same street that is level with ``target`` at time ``at_s``."""
    speed = tuple((t, v + faster) for t, v in target.speed)
    level = target.start + target.direction * float(target.distance(np.array([at_s]))[0])
    draft = replace(target, start=0.0, lane=lane, speed=speed, shift=((0.0, 0.0),))
    return replace(draft, start=level - target.direction * float(draft.distance(np.array([at_s]))[0]))


def _occlusion_lorry(vehicle: str, r: np.random.Generator) -> Trajectory:
    """A lorry overtakes between the car and the drone, which flies abeam."""
    target = Drive("main", 384.0 + r.uniform(-3, 3), 1, 1.55, _steady(7.2 + r.uniform(-0.4, 0.4)))
    hidden = max(2.0, 1.28 * FLEET["lorry"].length - FLEET[vehicle].length)
    faster = float(np.clip(hidden / r.uniform(1.2, 2.4), 2.0, 6.0))
    lorry = _passing(target, faster, -1.45, 2.9 + r.uniform(-0.2, 0.2))
    flight = Flight(LEFT_ABEAM, 22.0, (15.5, 14.0), (4.4, 7.8))
    return Trajectory("occlusion_lorry", target, flight, (("lorry", lorry),), sun=(47.0, 170.0))


def _occlusion_trees(vehicle: str, r: np.random.Generator) -> Trajectory:
    """Signs, trees and a poster wall between the street and the drone pass over the car."""
    start = 384.0 + r.uniform(-3, 3)
    target = Drive("main", start, 1, 1.55, _steady(6.0 + r.uniform(-0.3, 0.3)))
    at = start + np.array([7.5, 12.0, 14.3, 16.6, 24.5, 29.0]) + r.uniform(-0.4, 0.4, 6)
    planted = [Stand("sign", int(r.integers(12)), at[0], -1, 0.4), Stand("lamp", 1, at[5], -1, 0.5)]
    for k in (1, 2, 3):
        planted += [
            Stand("tree", int(r.integers(5)), at[k] + 0.6 * twin, -1, 0.9 + 0.5 * twin, 0.8, 2.0 * twin)
            for twin in (0, 1)
        ]
    planted.append(Stand("poster_wall", int(r.integers(12)), at[4], -1, 1.0))
    flight = Flight(RIGHT_ABEAM, 14.0, (13.0, 14.5), (4.2, 6.6))
    return Trajectory("occlusion_trees", target, flight, planted=tuple(planted), sun=(50.0, 20.0))


def _sweep(vehicle: str, r: np.random.Generator) -> Trajectory:
    """A short, high parcel car overtakes: it hides every part once, but never more than two thirds."""
    target = Drive("main", 384.0 + r.uniform(-3, 3), 1, 1.55, _steady(6.6 + r.uniform(-0.4, 0.4)))
    courier = _passing(target, 2.6 + r.uniform(0, 0.8), -1.35, 2.9 + r.uniform(-0.2, 0.2))
    flight = Flight(LEFT_ABEAM, 8.0, (18.5, 17.5), (2.3, 4.9))
    return Trajectory("sweep", target, flight, (("courier", courier),), sun=(47.0, 170.0))


def _leaving(vehicle: str, r: np.random.Generator) -> Trajectory:
    """The camera turns away until the car has left the picture, and comes back."""
    target = Drive("linden", 112.0 + r.uniform(-3, 3), 1, 1.7, ((0, 7.0), (2.2, 6.2), (END_S, 7.6)))
    away = (46.0 + r.uniform(0, 6)) * float(r.choice([-1.0, 1.0]))
    stay = r.uniform(0.3, 0.9)
    gaze = ((0.0, 0.0), (1.6, 0.0), (2.6, away), (2.6 + stay, away), (3.6 + stay, 0.0), (END_S, 0.0))
    flight = Flight(ALL_ROUND, 34.0, (16.5, 14.5), (5.2, 10.5), gaze)
    return Trajectory("leaving", target, flight, watched=False, sun=(49.0, 205.0))


def _stop_and_go(vehicle: str, r: np.random.Generator) -> Trajectory:
    """The car drives up to the stop line, stands for about two seconds, and drives on."""
    halt = 1.7 + r.uniform(-0.1, 0.1)
    speed = ((0.0, 7.0), (halt, 0.0), (halt + r.uniform(1.5, 2.0), 0.0), (5.6, 6.5))
    draft = Drive("main", 0.0, 1, 1.5, speed)
    start = STOP_LINE_M - FLEET[vehicle].nose_x - 0.6 - float(draft.distance(np.array([halt]))[0])
    crossing = Drive("north", 268.0 + r.uniform(-2, 2), 1, 1.5, ((0.0, 10.5), (END_S, 10.5)))
    flight = Flight(ALL_ROUND, 48.0, (17.0, 15.0), (5.4, 11.5))
    others = (("hatchback", crossing),)
    return Trajectory("stop_and_go", replace(draft, start=start), flight, others, sun=(53.0, 150.0))


def _dashcam(drive: Drive, view: tuple[float, float], r: np.random.Generator) -> Dashcam:
    """A camera at 1.3 to 1.6 m in a car on springs."""
    sway, heave = r.uniform(0.25, 0.55), r.uniform(0.006, 0.018)
    return Dashcam(drive, r.uniform(1.32, 1.56), r.uniform(*view), r.uniform(1.0, 4.0), sway, heave)


def _road(name: str, target: Drive, camera: Dashcam, others: tuple = (), sun: tuple = (50.0, 60.0)) -> Trajectory:
    """A dashcam's drive over smooth asphalt."""
    return Trajectory(name, target, camera, others, near_degenerate=True, sun=sun, asphalt="smooth", watched=False)


def _dashcam_following(vehicle: str, r: np.random.Generator) -> Trajectory:
    """The target drives ahead at 9 to 32 m; two cars come along the other lane."""
    start, pace = 262.0 + r.uniform(-4, 4), r.uniform(0.95, 1.05)
    host = Drive("main", start, 1, 1.5, ((0, 10.5 * pace), (3.0, 10.0 * pace), (END_S, 8.5 * pace)))
    gap = 27.0 + FLEET[vehicle].length / 2
    ahead = Drive("main", start + gap, 1, 1.5, ((0, 5.2 * pace), (2.6, 5.8 * pace), (END_S, 11.5 * pace)))
    others = (
        ("saloon", Drive("main", start + 74.0, -1, 1.5, _steady(8.0))),
        ("van", Drive("main", start + 128.0, -1, 1.5, _steady(8.6))),
    )
    return _road("dashcam_following", ahead, _dashcam(host, (62.0, 74.0), r), others, (50.0, 238.0))


def _dashcam_oncoming(vehicle: str, r: np.random.Generator) -> Trajectory:
    """The target comes along the other lane from about 50 m and passes; a car drives ahead."""
    start, pace = 330.0 + r.uniform(-4, 4), r.uniform(0.95, 1.05)
    host = Drive("main", start, 1, 1.5, ((0, 5.0 * pace), (END_S, 5.4 * pace)))
    gap = 50.0 + FLEET[vehicle].length / 2
    oncoming = Drive("main", start + gap, -1, 1.55, ((0, 4.6 * pace), (END_S, 5.0 * pace)))
    others = (("hatchback", Drive("main", start + 15.0, 1, 1.5, ((0, 5.4 * pace), (END_S, 8.4 * pace)))),)
    return _road("dashcam_oncoming", oncoming, _dashcam(host, (60.0, 68.0), r), others, (44.0, 250.0))


def _dashcam_town(vehicle: str, r: np.random.Generator) -> Trajectory:
    """Round a bend after the target, with a wide view."""
    start, pace = 14.0 + r.uniform(-2, 2), r.uniform(0.95, 1.05)
    host = Drive("linden", start, 1, 1.6, ((0, 6.4 * pace), (3.0, 5.6 * pace), (END_S, 6.2 * pace)))
    gap = 9.0 + FLEET[vehicle].length / 2
    ahead = Drive("linden", start + gap, 1, 1.6, ((0, 6.8 * pace), (2.4, 7.2 * pace), (END_S, 5.4 * pace)))
    return _road("dashcam_town", ahead, _dashcam(host, (80.0, 90.0), r), sun=(55.0, 300.0))


def _hovering(vehicle: str, r: np.random.Generator) -> Trajectory:
    """A drone hovers at 25 to 50 m in light wind; cars come and follow."""
    start = 384.0 + r.uniform(-3, 3)
    target = Drive("main", start, 1, 1.55, _steady(7.0 + r.uniform(-0.5, 0.5)))
    oncoming = Drive("main", start + 52.0, -1, 1.55, _steady(8.0 + r.uniform(-0.5, 0.5)))
    following = replace(target, start=start - 14.0 + r.uniform(-1, 1))
    height, pitch = r.uniform(25.0, 50.0), np.radians(r.uniform(35.0, 60.0))
    flight = Flight(ALL_ROUND, 0.0, (height / np.tan(pitch),) * 2, (height,) * 2, wind=r.uniform(0.1, 0.4))
    others = (("saloon", oncoming), ("van", following))
    return Trajectory("hovering", target, flight, others, near_degenerate=True, sun=(50.0, 140.0))


def _hovering_high(vehicle: str, r: np.random.Generator) -> Trajectory:
    """A drone hovers over a crossing at 50 to 120 m, 50° to 85° down; vehicles drive both ways on both streets."""
    start = 444.0 + r.uniform(-3, 3)
    target = Drive("main", start, 1, 1.55, _steady(7.0 + r.uniform(-0.5, 0.5)))
    oncoming = Drive("main", start + 82.0, -1, 1.55, _steady(8.0 + r.uniform(-0.5, 0.5)))
    following = replace(target, start=start - 16.0 + r.uniform(-1, 1))
    away = Drive("north", 310.0 + r.uniform(0, 3), 1, 1.5, _steady(6.5 + r.uniform(-0.5, 0.5)))
    away_too = Drive("north", 294.0 - r.uniform(0, 3), -1, 1.5, _steady(7.5 + r.uniform(-0.5, 0.5)))
    height, pitch = r.uniform(50.0, 120.0), np.radians(r.uniform(50.0, 85.0))
    flight = Flight(ALL_ROUND, 0.0, (height / np.tan(pitch),) * 2, (height,) * 2, wind=r.uniform(0.2, 1.0))
    others = (("saloon", oncoming), ("van", following), ("lorry", away), ("smart", away_too))
    return Trajectory("hovering_high", target, flight, others, near_degenerate=True, sun=(50.0, 140.0))


def _hovering_leaving(vehicle: str, r: np.random.Generator) -> Trajectory:
    """As `hovering` for half of the time; then the drone flies 16 to 22 m along the street."""
    hovering = _hovering(vehicle, r)
    away = ((0.0, 0.0), (END_S / 2, 0.0), (END_S, r.uniform(16.0, 22.0)))
    return replace(hovering, name="hovering_leaving", flight=replace(hovering.flight, away=away))


def _hovering_hill(vehicle: str, r: np.random.Generator) -> Trajectory:
    """A drone hovers at 40 to 60 m where a street begins to climb, by up to 14 %; vehicles drive both ways."""
    start = 402.0 + r.uniform(-4, 4)
    target = Drive("north", start, 1, 1.5, _steady(8.0 + r.uniform(-0.5, 0.5)))
    above = replace(target, start=start + 62.0 + r.uniform(-2, 2))
    down = Drive("north", start + 108.0, -1, 1.5, _steady(9.0 + r.uniform(-0.5, 0.5)))
    down_too = replace(down, start=start + 46.0 + r.uniform(-2, 2))
    height, pitch = r.uniform(40.0, 60.0), np.radians(r.uniform(40.0, 55.0))
    flight = Flight(ALL_ROUND, 0.0, (height / np.tan(pitch),) * 2, (height,) * 2, wind=r.uniform(0.1, 0.4))
    others = (("saloon", above), ("van", down), ("saloon", down_too))
    return Trajectory("hovering_hill", target, flight, others, near_degenerate=True, sun=(50.0, 140.0))


def _hovering_nadir(vehicle: str, r: np.random.Generator) -> Trajectory:
    """As `hovering_high` at 40 to 110 m, 84° to 90° down."""
    high = _hovering_high(vehicle, r)
    height, pitch = r.uniform(40.0, 110.0), np.radians(r.uniform(84.0, 89.5))
    flight = replace(high.flight, distance=(height / np.tan(pitch),) * 2, height=(height,) * 2)
    return replace(high, name="hovering_nadir", flight=flight)


Scenario = Callable[[str, np.random.Generator], Trajectory]
SCENARIOS: dict[str, Scenario] = {
    "occlusion_lorry": _occlusion_lorry,
    "occlusion_trees": _occlusion_trees,
    "sweep": _sweep,
    "leaving": _leaving,
    "stop_and_go": _stop_and_go,
    "dashcam_following": _dashcam_following,
    "dashcam_oncoming": _dashcam_oncoming,
    "dashcam_town": _dashcam_town,
    "hovering": _hovering,
    "hovering_high": _hovering_high,
    "hovering_leaving": _hovering_leaving,
    "hovering_hill": _hovering_hill,
    "hovering_nadir": _hovering_nadir,
}
NAMES = (*TRAJECTORIES, *SCENARIOS)
# What is rendered of each scenario, in the order in which it is useful.
CHOSEN = (
    ("occlusion_lorry", "hatchback"),
    ("dashcam_following", "suv"),
    ("sweep", "suv"),
    ("leaving", "saloon"),
    ("dashcam_oncoming", "lorry"),
    ("occlusion_trees", "saloon"),
    ("stop_and_go", "bus"),
    ("dashcam_town", "hatchback"),
    ("right_curves", "lorry"),
    ("hovering", "hatchback"),
    ("hovering_high", "suv"),
    ("hovering_leaving", "saloon"),
    ("hovering_hill", "suv"),
    ("hovering_nadir", "van"),
)


def trajectory(name: str, vehicle: str, seed: int) -> Trajectory:
    """One of the seven, or a scenario, as one vehicle drives it."""
    if name in TRAJECTORIES:
        return variant(name, vehicle, seed)
    return SCENARIOS[name](vehicle, rng("scenario", name, vehicle, seed))
