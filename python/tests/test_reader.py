"""Tests against a small folder made here. Run: python -m unittest discover -s python/tests."""

from __future__ import annotations

import json
import pickle
import sys
import tempfile
import unittest
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

import sample  # noqa: E402

import tractrix  # noqa: E402
from tractrix.geometry import rotation_matrix  # noqa: E402
from tractrix.tables import NAMES  # noqa: E402


def missing(module: str) -> bool:
    try:
        __import__(module)
    except ImportError:
        return True
    return False


class Case(unittest.TestCase):
    def setUp(self) -> None:
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = Path(temporary.name) / "out"
        sample.write_output(self.folder)

    def change(self, edit: Callable[[dict[str, Any]], None]) -> None:
        document = sample.trajectories()
        edit(document)
        (self.folder / "trajectories.json").write_text(json.dumps(document))


class Reading(Case):
    def test_vehicles_have_the_values_of_the_file(self) -> None:
        results = tractrix.load(self.folder)
        vehicle = results.vehicles[1]
        self.assertEqual(list(results.vehicles), [1, 4, 5])
        self.assertEqual((vehicle.class_name, vehicle.verdict.state, len(vehicle)), ("car", "good", 3))
        self.assertEqual(vehicle.verdict.reasons[0].finding, "supports")
        np.testing.assert_allclose(vehicle.time_s, [0, 0.5, 1])
        np.testing.assert_allclose(vehicle.speed_kmh, [7.2, 7.2, np.nan])
        self.assertEqual(vehicle.position_m.shape, (3, 3))
        self.assertTrue(np.isnan(vehicle.position_m[2]).all() and np.isnan(vehicle.heading_deg).all())
        self.assertEqual(vehicle.travel.path_m, tractrix.Estimate(2.0, 0.1))
        self.assertIsNone(vehicle.travel.mean_speed_m_s)
        self.assertIsNone(vehicle.dimensions.width_m)
        self.assertEqual((vehicle.scale.ratio, vehicle.scale.std), (0.5, 0.01))
        self.assertIsNone(results.vehicles[5].verdict)

    def test_unknown_keys_are_kept(self) -> None:
        results = tractrix.load(self.folder)
        vehicle = results.vehicles[1]
        self.assertEqual((results.raw["later_key"], vehicle.raw["later_key"]), ([1, 2], "kept"))
        self.assertEqual(vehicle.scale.raw["later_key"], 1)
        np.testing.assert_allclose(vehicle.column("later_key"), [0, 1, 2])

    def test_transforms_are_those_of_the_conventions(self) -> None:
        results = tractrix.load(self.folder)
        vehicle = results.vehicles[1]
        np.testing.assert_allclose(vehicle.world_from_object(1) * [2.0, 0, 0], [0, 1.1, 0], atol=1e-12)
        np.testing.assert_allclose(results.to_metric(vehicle.position)[:2], vehicle.position_m[:2], atol=1e-12)
        pose = vehicle.world_from_object(1)
        np.testing.assert_allclose(pose.inverse() * (pose * [1.0, 2, 3]), [1, 2, 3])
        np.testing.assert_allclose(pose.matrix() @ [1, 2, 3, 1], [*(pose * [1.0, 2, 3]), 1])

    def test_a_rotation_gives_its_quaternion(self) -> None:
        for q in np.random.default_rng(1).normal(size=(50, 4)):
            q = q / np.linalg.norm(q) * np.sign(q[0])
            np.testing.assert_allclose(tractrix.Sim3(1.0, rotation_matrix(q), np.zeros(3)).wxyz(), q, atol=1e-12)

    def test_ground_tracks_are_no_trajectories(self) -> None:
        results = tractrix.load(self.folder)
        track = results.ground_tracks[4]
        self.assertNotIsInstance(track, tractrix.Vehicle)
        self.assertIsInstance(results.vehicles[4], tractrix.Vehicle)
        self.assertEqual((track.verdict.state, track.omitted["truncated"]), ("usable", 2))
        np.testing.assert_allclose(track.covariance, [np.diag([2.0, 6.0, 3.0])])
        self.assertNotIn("truck", results.table("trajectories")["class"])
        self.assertEqual(list(results.table("ground_positions")["vehicle"]), [4])

    def test_verdicts_select(self) -> None:
        results = tractrix.load(self.folder)
        self.assertEqual([vehicle.id for vehicle in results.select("fair")], [1])
        self.assertEqual([vehicle.id for vehicle in results.select("rejected")], [1, 4])
        with self.assertRaises(ValueError):
            results.select("best")

    def test_masks_have_every_filter(self) -> None:
        results = tractrix.load(self.folder)
        self.assertEqual({number: list(masks) for number, masks in results.masks.items()}, {1: ["middle.jpg"]})
        np.testing.assert_array_equal(results.vehicles[1].mask(1), sample.mask_image() > 127)
        with self.assertRaises(tractrix.MissingError):
            results.vehicles[1].mask(0)
        with self.assertRaises(KeyError):
            results.masks[1]["left.jpg"]

    def test_points_of_both_forms_are_equal(self) -> None:
        results = tractrix.load(self.folder)
        for cloud in (results.points, results.vehicles[1].points):
            np.testing.assert_allclose(cloud.xyz, [[1, 2, 3], [4, 5, 6]])
            np.testing.assert_array_equal(cloud.rgb, [[10, 20, 30], [40, 50, 60]])

    def test_models_of_both_forms_are_equal(self) -> None:
        results = tractrix.load(self.folder)
        text, binary = results.background, results.vehicles[1].reconstruction
        self.assertEqual([image.name for image in text.images.values()], sample.NAMES)
        self.assertEqual(list(text.images), list(binary.images))
        for number, image in text.images.items():
            other = binary.images[number]
            self.assertEqual((image.name, image.camera_id), (other.name, other.camera_id))
            np.testing.assert_allclose(image.cam_from_world.matrix(), other.cam_from_world.matrix(), atol=1e-12)
            np.testing.assert_allclose(image.points2D, other.points2D)
            np.testing.assert_array_equal(image.point3D_ids, other.point3D_ids)
        for number, camera in text.cameras.items():
            self.assertEqual(camera.model, binary.cameras[number].model)
            np.testing.assert_allclose(camera.params, binary.cameras[number].params)
        np.testing.assert_allclose(text.points3D.xyz, binary.points3D.xyz)
        np.testing.assert_array_equal(text.points3D.rgb, binary.points3D.rgb)
        for track, other in zip(text.points3D.tracks, binary.points3D.tracks):
            np.testing.assert_array_equal(track, other)

    def test_points_project_to_their_observations(self) -> None:
        model = tractrix.load(self.folder).background
        points = dict(zip(model.points3D.ids.tolist(), model.points3D.xyz))
        for image in model.images.values():
            observed = image.point3D_ids >= 0
            xyz = np.array([points[i] for i in image.point3D_ids[observed].tolist()])
            errors = np.linalg.norm(model.project(xyz, image) - image.points2D[observed], axis=1)
            self.assertLess(errors.max(), 5.0)
        self.assertTrue(np.isnan(model.cameras[1].img_from_cam([0.0, 0, -1])).all())

    def test_cameras_are_by_frame(self) -> None:
        cameras = tractrix.load(self.folder).cameras
        np.testing.assert_array_equal(cameras.frames, [0, 1, 2])
        self.assertEqual(cameras.image(1).name, "middle.jpg")
        np.testing.assert_allclose(cameras.world_from_cam(2) * np.zeros(3), cameras.center[2])
        np.testing.assert_allclose(cameras.center_m, tractrix.load(self.folder).to_metric(cameras.center))
        with self.assertRaises(tractrix.MissingError):
            cameras.image(9)

    def test_without_meters_only_meters_are_missing(self) -> None:
        def edit(document: dict[str, Any]) -> None:
            document["metric"] = {"verdict": "unknown", "reason": "no source of scale"}
            del document["ground_tracks"]

        self.change(edit)
        results = tractrix.load(self.folder)
        self.assertEqual((results.metric.verdict, results.ground_tracks), ("unknown", {}))
        self.assertTrue(np.isnan(results.cameras.center_m).all())
        with self.assertRaises(tractrix.MissingError):
            results.to_metric([0.0, 0, 0])


class Faults(Case):
    def fails(self, kind: type[tractrix.OutputError], *words: str) -> None:
        with self.assertRaises(kind) as caught:
            tractrix.load(self.folder)
        message = str(caught.exception)
        self.assertRegex(message, r"^.+: .+; .+$")
        for word in words:
            self.assertIn(word, message)
        self.assertEqual(str(pickle.loads(pickle.dumps(caught.exception))), message)

    def test_other_versions(self) -> None:
        for version, remedy in ((2, "repeat the `tractrix run`"), (4, "use the Python package")):
            self.change(lambda document, version=version: document.update(version=version))
            self.fails(tractrix.VersionError, f"version {version}", remedy)

    def test_no_output_folder(self) -> None:
        (self.folder / "trajectories.json").unlink()
        self.fails(tractrix.MissingError, "trajectories.json", "no such file")
        self.folder = self.folder / "nothing"
        self.fails(tractrix.MissingError, "no such folder")

    def test_damaged_files_name_the_key(self) -> None:
        def frame(document: dict[str, Any]) -> dict[str, Any]:
            return document["objects"][0]["frames"][1]

        edits: dict[str, Callable[[dict[str, Any]], None]] = {
            "objects[0].frames[1].position": lambda document: frame(document).update(position=[0, 1]),
            "objects[0].frames[1].frame": lambda document: frame(document).update(frame="one"),
            "not ascending": lambda document: frame(document).update(frame=0),
            "objects[0].frames[1].world_from_object.rotation_wxyz": lambda document: frame(document)[
                "world_from_object"
            ].update(rotation_wxyz=[2, 0, 0, 0]),
            "occurs twice": lambda document: document["objects"][1].update(id=1),
            "objects[0].verdict.state": lambda document: document["objects"][0]["verdict"].update(state="best"),
            "`objects`": lambda document: document.update(objects=None),
            "`unit`": lambda document: document.update(unit="mile"),
        }
        for words, edit in edits.items():
            with self.subTest(words):
                self.change(edit)
                self.fails(tractrix.DamagedError, words)

    def test_truncated_json(self) -> None:
        path = self.folder / "trajectories.json"
        path.write_bytes(path.read_bytes()[:-20])
        self.fails(tractrix.DamagedError, "truncated")
        path.write_bytes(b"\xff\xfe")
        self.fails(tractrix.DamagedError, "UTF-8")

    def test_every_truncated_file_is_an_error_of_the_package(self) -> None:
        readers = {
            "background/images.txt": lambda: tractrix.load(self.folder).background,
            "objects/1/cameras.bin": lambda: tractrix.load(self.folder).vehicles[1].reconstruction,
            "objects/1/images.bin": lambda: tractrix.load(self.folder).vehicles[1].reconstruction,
            "objects/1/points3D.bin": lambda: tractrix.load(self.folder).vehicles[1].reconstruction,
            "tracks/1/middle.jpg.png": lambda: tractrix.load(self.folder).vehicles[1].mask(1),
            "ply/background.ply": lambda: tractrix.load(self.folder).points,
        }
        for name, reader in readers.items():
            path = self.folder / name
            whole = path.read_bytes()
            for length in range(0, len(whole), 7) if path.suffix != ".txt" else (len(whole) // 2, len(whole) - 8):
                path.write_bytes(whole[:length])
                try:
                    reader()
                except tractrix.OutputError:
                    continue
                except Exception as error:  # noqa: BLE001
                    self.fail(f"{name} cut to {length} bytes: {error!r}")
            path.write_bytes(whole)
            reader()


class Tables(Case):
    def test_columns_have_one_length(self) -> None:
        results = tractrix.load(self.folder)
        for name, rows in (("trajectories", 9), ("vehicles", 3), ("ground_positions", 1), ("ground_tracks", 1)):
            table = results.table(name)
            self.assertEqual({len(column) for column in table.values()}, {rows}, name)
        self.assertEqual(len(results.table("trajectories", "good")["frame"]), 3)
        self.assertEqual(list(results.table("vehicles")["verdict"]), ["good", "rejected", None])
        np.testing.assert_allclose(results.table()["place_std_m"][:2], 0.5)
        with self.assertRaises(ValueError):
            results.table("nothing")

    def test_empty_results_have_the_same_columns(self) -> None:
        columns = {name: list(tractrix.load(self.folder).table(name)) for name in NAMES}
        self.change(lambda document: document.update(objects=[], ground_tracks=[]))
        results = tractrix.load(self.folder)
        self.assertEqual({name: list(results.table(name)) for name in NAMES}, columns)
        self.assertEqual(len(results.table("vehicles")["vehicle"]), 0)

    @unittest.skipIf(missing("pandas"), "pandas is not installed")
    def test_pandas(self) -> None:
        frame = tractrix.load(self.folder).to_pandas()
        self.assertEqual(frame.groupby("vehicle").speed_m_s.mean().to_list(), [2.0] * 3)

    @unittest.skipUnless(missing("pandas"), "pandas is installed")
    def test_without_pandas_the_remedy_is_named(self) -> None:
        with self.assertRaisesRegex(tractrix.MissingError, "pip install pandas"):
            tractrix.load(self.folder).to_pandas()

    @unittest.skipIf(missing("geopandas"), "geopandas is not installed")
    def test_geopandas(self) -> None:
        results = tractrix.load(self.folder)
        lines = results.to_geopandas("vehicles")
        self.assertEqual((lines.crs.to_epsg(), len(lines.geometry[0].coords)), (4326, 2))
        self.assertEqual(results.to_geopandas().geometry[0].coords[0], (8.0, 49.0))
        self.assertTrue(results.to_geopandas("ground_tracks").geometry[0].is_empty)

    def test_positions_that_are_not_georeferenced_are_refused(self) -> None:
        self.change(lambda document: document["metric"].update(origin=None))
        with self.assertRaisesRegex(tractrix.MissingError, "--telemetry"):
            tractrix.load(self.folder).to_geopandas()

    @unittest.skipIf(missing("matplotlib"), "matplotlib is not installed")
    def test_plots(self) -> None:
        import matplotlib

        matplotlib.use("Agg")
        results = tractrix.load(self.folder)
        speeds = tractrix.plot_speeds(results, unit="m/s")
        self.assertEqual(len(speeds.lines), 3)
        labels = [line.get_label() for line in tractrix.plot_paths(results).lines]
        self.assertIn("camera", labels)
        self.assertIn("truck 4 (ground track, usable)", labels)
        colors = {line.get_label(): line.get_color() for line in tractrix.plot_paths(results).lines}
        self.assertEqual(colors["truck 4 (ground track, usable)"], colors["car 4 (rejected)"])
        self.assertNotEqual(colors["car 1 (good)"], colors["car 4 (rejected)"])
        self.assertEqual(len(tractrix.plot_map(results, min_verdict="good").lines), 2)
        with self.assertRaises(ValueError):
            tractrix.plot_speeds(results, unit="knots")


if __name__ == "__main__":
    unittest.main()
