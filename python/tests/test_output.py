"""Tests against a real output folder, that of the environment variable TRACTRIX_OUTPUT; scripts/test makes one."""

from __future__ import annotations

import csv
import os
import sys
import unittest
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import tractrix  # noqa: E402

FOLDER = os.environ.get("TRACTRIX_OUTPUT")
# Tables by the file of `export --format csv`.
TABLES = {
    "trajectories": "trajectories.csv",
    "vehicles": "vehicles.csv",
    "ground_positions": "ground-positions.csv",
    "ground_tracks": "ground-tracks.csv",
    "camera": "camera.csv",
}


@unittest.skipUnless(FOLDER, "TRACTRIX_OUTPUT names no output folder")
class Output(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        cls.results = tractrix.load(FOLDER or "")

    def test_poses_place_the_models_at_the_positions(self) -> None:
        for vehicle in self.results.vehicles.values():
            xyz = vehicle.reconstruction.points3D.xyz
            for frame, position in zip(vehicle.frames.tolist(), vehicle.position):
                placed = vehicle.world_from_object(frame) * xyz
                # The position is the mean without outliers: it lies between the points, near their median.
                spread = np.abs(placed - np.median(placed, axis=0)).mean()
                self.assertLess(np.abs(position - np.median(placed, axis=0)).max(), 2 * spread)

    def test_meters_are_those_of_the_metric_transform(self) -> None:
        for vehicle in self.results.vehicles.values():
            known = np.isfinite(vehicle.position_m).all(axis=1)
            metric = self.results.to_metric(vehicle.position[known])
            np.testing.assert_allclose(metric, vehicle.position_m[known], atol=1e-6)

    def test_reprojection_error_is_that_of_the_run(self) -> None:
        model = self.results.background
        row_of = {number: row for row, number in enumerate(model.points3D.ids.tolist())}
        errors = []
        for image in model.images.values():
            observed = image.point3D_ids >= 0
            rows = [row_of[number] for number in image.point3D_ids[observed].tolist()]
            projected = model.project(model.points3D.xyz[rows], image)
            errors.append(np.linalg.norm(projected - image.points2D[observed], axis=1))
        stated = self.results.run["stages"]["background"]["figures"]["mean_error_px"]
        self.assertAlmostEqual(float(np.concatenate(errors).mean()), stated, delta=0.01)

    def test_masks_contain_the_projected_positions(self) -> None:
        for vehicle in self.results.vehicles.values():
            if vehicle.verdict is None or vehicle.verdict.state == "rejected":
                continue
            frame = int(vehicle.frames[len(vehicle) // 2])
            mask = vehicle.mask(frame)
            info = self.results.run["input"]["info"]
            self.assertEqual(mask.shape, (info["height"], info["width"]))
            column, row = self.results.cameras.project(vehicle.position[len(vehicle) // 2], frame)
            rows, columns = np.nonzero(mask)
            self.assertLess(abs(column - columns.mean()), np.ptp(columns))
            self.assertLess(abs(row - rows.mean()), np.ptp(rows))

    def test_points_are_those_of_the_models(self) -> None:
        np.testing.assert_allclose(self.results.points.xyz, self.results.background.points3D.xyz)
        for vehicle in self.results.vehicles.values():
            placed = vehicle.world_from_object(int(vehicle.frames[0])) * vehicle.reconstruction.points3D.xyz
            self.assertEqual(len(vehicle.points), len(vehicle) * len(placed))

    def test_tables_equal_the_exported_ones(self) -> None:
        exported = self.results.folder / "export"
        for name, file in TABLES.items():
            with self.subTest(file), (exported / file).open(newline="") as text:
                rows = list(csv.DictReader(text))
                table = self.results.table(name)
                common = [column for column in table if rows and column in rows[0]]
                for column in common:
                    cells = [row[column] for row in rows]
                    if table[column].dtype == object:
                        self.assertEqual(cells, [value or "" for value in table[column]], column)
                    else:
                        values = [float(cell) if cell else np.nan for cell in cells]
                        np.testing.assert_allclose(table[column], values, rtol=1e-6, atol=6e-5, err_msg=column)
                self.assertTrue(not rows or len(common) >= len(table) - 3, f"{file} lacks columns of {name}")


if __name__ == "__main__":
    unittest.main()
