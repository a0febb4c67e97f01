"""Tests of the generator's parts that need no Blender. Run: python -m unittest discover -s dataset/tests."""

from __future__ import annotations

import os
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import render_all  # noqa: E402
from tractrix_dataset import drives, labels, mesh, plan, seeds  # noqa: E402
from tractrix_dataset.paths import Path as Way  # noqa: E402
from tractrix_dataset.validate import _ground_heights, silhouette  # noqa: E402


class Seeds(unittest.TestCase):
    def test_a_generator_depends_on_its_key_alone(self) -> None:
        first = seeds.rng("tree", 1).random(4)
        seeds.rng("tree", 2).random(100)
        np.testing.assert_array_equal(first, seeds.rng("tree", 1).random(4))
        self.assertNotEqual(seeds.digest("ab", "c"), seeds.digest("a", "bc"))

    def test_noise_is_continuous_and_bounded(self) -> None:
        x = np.linspace(-30, 30, 20001)
        values = seeds.noise(x, 0.37 * x, 2.0, "test")
        self.assertLessEqual(np.abs(values).max(), 1.0)
        self.assertGreater(np.ptp(values), 0.8)
        self.assertLess(np.abs(np.diff(values)).max(), 0.02)


class Ways(unittest.TestCase):
    def test_points_of_a_way_lie_on_it_at_their_arc_length(self) -> None:
        way = Way([(0, 0, 0), (40, 0, 12), (40, 30, 0)])
        s = np.linspace(0, way.length, 200)
        points = way.point(s)
        distance, along = way.locate(*points.T)
        self.assertLess(distance.max(), 1e-9)
        np.testing.assert_allclose(along, s, atol=1e-6)
        steps = np.hypot(*np.diff(points, axis=0).T)
        np.testing.assert_allclose(steps.sum(), way.length, rtol=1e-3)

    def test_offsets_are_to_the_left(self) -> None:
        way = Way([(0, 0, 0), (10, 0, 0)])
        np.testing.assert_allclose(way.offset_point(np.array([5.0]), 2.0), [[5.0, 2.0]], atol=1e-9)


class Plan(unittest.TestCase):
    def test_the_answer_at_a_point_does_not_depend_on_the_others_asked(self) -> None:
        r = seeds.rng("points")
        x, y = r.uniform(-400, 400, (2, 300))
        together = plan.surface_height(x, y)
        alone = [float(plan.surface_height(x[i : i + 1], y[i : i + 1])[0]) for i in range(300)]
        np.testing.assert_allclose(together, alone, atol=1e-9)

    def test_the_bridge_meets_the_street_and_stands_over_the_river(self) -> None:
        for x in (plan.BRIDGE_START_M - 0.1, plan.BRIDGE_END_M + 0.1):
            at = np.array([x]), np.array([0.0])
            self.assertLess(abs(float((plan.deck_height(*at) - plan.ground_height(*at))[0])), 0.02)
        middle = np.array([plan.RIVER_X_M]), np.array([0.0])
        self.assertGreater(float((plan.deck_height(*middle) - plan.ground_height(*middle))[0]), 4.0)

    def test_the_ground_stays_under_the_deck_and_beside_it_meets_the_land(self) -> None:
        x, y = (v.ravel() for v in np.meshgrid(np.arange(288.1, 372.0, 0.37), np.linspace(-7.3, 7.3, 41)))
        self.assertGreater(float((plan.deck_height(x, y) - plan.ground_height(x, y)).min()), 0.25)
        y = np.concatenate([np.linspace(-30, -9, 60), np.linspace(9, 30, 60)])
        for edge in (plan.BRIDGE_START_M, plan.BRIDGE_END_M):
            here, there = (plan.ground_height(np.full(120, edge + step), y) for step in (-1e-3, 1e-3))
            self.assertLess(float(np.abs(here - there).max()), 0.02)

    def test_the_bridge_is_driven_over_its_deck(self) -> None:
        for vehicle in ("saloon", "van"):
            drive = drives.variant("bridge", vehicle, 0).drive
            points = drive.curve().point(drive.distance(drives.frame_times(60)))
            self.assertTrue(plan.over_river(*points.T).any())
            steps = np.diff(plan.surface_height(*drive.curve().point(np.arange(0, 50, 0.1)).T))
            self.assertLess(float(np.abs(steps).max()), 0.01)

    def test_the_steep_street_is_steep(self) -> None:
        y = np.array([200.0, 220.0])
        rise = np.diff(plan.base_height(np.zeros(2), y))[0] / 20
        self.assertTrue(0.10 < rise < 0.18, rise)


class Drives(unittest.TestCase):
    def test_no_two_vehicles_meet(self) -> None:
        times = drives.frame_times(60)
        for name, trajectory in drives.TRAJECTORIES.items():
            for vehicle in ("saloon", "suv", "smart", "hatchback", "van") if trajectory.others else ():
                target = drives.variant(name, vehicle, 0).drive
                driven = [target, *(drive for _, drive in trajectory.others)]
                bodies = [self._axis(drive, times) for drive in driven]
                for i, a in enumerate(bodies):
                    for b in bodies[:i]:
                        gap = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1).min()
                        self.assertGreater(gap, 2.3, f"{name}, {vehicle}")

    @staticmethod
    def _axis(drive: drives.Drive, times: np.ndarray) -> np.ndarray:
        """Points (N, 13, 2) on the middle line of a vehicle of 4.8 m, per frame."""
        s = drive.distance(times)[:, None] + np.linspace(-2.4, 2.4, 13)
        return drive.curve().point(s.ravel()).reshape(*s.shape, 2)


class Meshes(unittest.TestCase):
    def test_ply_files_come_back(self) -> None:
        vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0.25)])
        triangles = np.array([(0, 1, 2)])
        with tempfile.TemporaryDirectory() as folder:
            for write in (mesh.write_ply, mesh.write_ply_ascii):
                path = Path(folder) / "m.ply"
                write(path, vertices, triangles, "test")
                v, t = mesh.read_ply(path)
                np.testing.assert_allclose(v, vertices, atol=1e-4)
                np.testing.assert_array_equal(t, triangles)


class Checks(unittest.TestCase):
    def test_a_projected_square_covers_its_pixels(self) -> None:
        corners = np.array([(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)], float)
        k = np.array([[20, 0, 32], [0, 20, 24], [0, 0, 1.0]])
        drawn = silhouette(corners, np.array([(0, 1, 2), (0, 2, 3)]), k, (48, 64))
        wanted = np.zeros((48, 64), bool)
        wanted[14:34, 22:42] = True
        self.assertGreater((drawn & wanted).sum() / (drawn | wanted).sum(), 0.9)

    def test_heights_come_from_the_triangle_under_the_point(self) -> None:
        ground = (np.array([(0, 0, 0), (2, 0, 2), (0, 2, 0)], float), np.array([(0, 1, 2)]))
        heights = _ground_heights(ground, np.array([(0.5, 0.5), (3.0, 3.0)]))
        self.assertAlmostEqual(heights[0], 0.5)
        self.assertTrue(np.isnan(heights[1]))

    def test_tidying_removes_lone_pixels_of_the_target_only(self) -> None:
        image = np.full((9, 9), labels.GROUND, np.uint8)
        image[2, 2] = labels.TARGET
        image[6, 6] = labels.OTHER
        tidied = labels.tidy(image)
        self.assertEqual(tidied[2, 2], labels.GROUND)
        self.assertEqual(tidied[6, 6], labels.OTHER)

    @unittest.skipUnless(hasattr(os, "sched_setaffinity"), "processes cannot be bound to a processor here")
    def test_renders_with_one_thread_have_a_processor_of_their_own(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder) / "render.py"
            script.write_text(
                "import os, sys, time, pathlib\n"
                "time.sleep(0.5)\n"
                "pathlib.Path(sys.argv[6]).write_text(str(len(os.sched_getaffinity(0))))\n"
            )
            out = Path(folder) / "out"
            with mock.patch.object(render_all, "SCRIPT", script):
                for passed, wanted in [(["--threads", "1"], 1), (["--threads", "4"], len(os.sched_getaffinity(0)))]:
                    processors = render_all.free_processors(passed)
                    before = len(processors)
                    self.assertTrue(render_all.render(out, "bridge", "van", passed, processors))
                    self.assertEqual(int(out.read_text()), wanted)
                    self.assertEqual(len(processors), before)


if __name__ == "__main__":
    unittest.main()
