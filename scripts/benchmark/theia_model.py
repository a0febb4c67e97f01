"""Theia's global structure from motion on the features and matches of a COLMAP database.

    python scripts/benchmark/theia_model.py database.db OUT [fx,fy,cx,cy]

Needs pytheia and pycolmap. All images have one camera, as it stands in the database if none is given; one that is given
is held. OUT becomes a COLMAP model in text, as Theia writes it: with six digits, and point errors of zero.
"""

import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytheia

# Matches below which a pair of images is left out; Theia's own default.
MIN_MATCHES = 30


def prior_of(camera: pycolmap.Camera, given: list[float] | None) -> pytheia.sfm.CameraIntrinsicsPrior:
    """What Theia is told of the camera."""
    prior = pytheia.sfm.CameraIntrinsicsPrior()
    prior.image_width, prior.image_height = camera.width, camera.height
    prior.camera_intrinsics_model_type = "PINHOLE"
    focal_x, focal_y, center_x, center_y = given or [camera.mean_focal_length()] * 2 + [
        camera.principal_point_x,
        camera.principal_point_y,
    ]
    for field, values in (
        (prior.focal_length, [focal_x]),
        (prior.aspect_ratio, [focal_y / focal_x]),
        (prior.principal_point, [center_x, center_y]),
    ):
        field.value, field.is_set = values, True
    return prior


def matched(
    database: pycolmap.Database, prior: pytheia.sfm.CameraIntrinsicsPrior, view_of: dict[int, int]
) -> tuple[pytheia.sfm.ViewGraph, pytheia.sfm.TrackBuilder]:
    """Relative poses and tracks from the inlier matches of all pairs."""
    graph, tracks = pytheia.sfm.ViewGraph(), pytheia.sfm.TrackBuilder(2, 100)
    options = pytheia.sfm.EstimateTwoViewInfoOptions()
    places = {image: np.asarray(database.read_keypoints(image), float)[:, :2] for image in view_of}
    for pair, geometry in zip(*database.read_two_view_geometries(), strict=True):
        a, b = pycolmap.pair_id_to_image_pair(pair)
        matches = [
            pytheia.matching.FeatureCorrespondence(pytheia.sfm.Feature(places[a][i]), pytheia.sfm.Feature(places[b][j]))
            for i, j in np.asarray(geometry.inlier_matches)
        ]
        if len(matches) < MIN_MATCHES:
            continue
        found, info, inliers = pytheia.sfm.EstimateTwoViewInfo(options, prior, prior, matches)
        if not found or len(inliers) < MIN_MATCHES:
            continue
        info.num_verified_matches = len(inliers)
        graph.AddEdge(view_of[a], view_of[b], info)
        for k in inliers:
            tracks.AddFeatureCorrespondence(view_of[a], matches[k].feature1, view_of[b], matches[k].feature2)
    return graph, tracks


def reconstruct(database_path: Path, output: Path, given: list[float] | None) -> None:
    """Writes Theia's model of what is in the database."""
    database = pycolmap.Database.open(str(database_path))
    prior = prior_of(database.read_all_cameras()[0], given)
    model = pytheia.sfm.Reconstruction()
    view_of = {}
    for image in database.read_all_images():
        view_of[image.image_id] = model.AddView(image.name, 0, float(image.image_id))
        model.MutableView(view_of[image.image_id]).SetCameraIntrinsicsPrior(prior)
    pytheia.sfm.SetCameraIntrinsicsFromPriors(model)
    graph, tracks = matched(database, prior, view_of)
    tracks.BuildTracks(model)
    options = pytheia.sfm.ReconstructionEstimatorOptions()
    options.num_threads = 1
    kinds = pytheia.sfm.OptimizeIntrinsicsType
    options.intrinsics_to_optimize = kinds.NONE if given else kinds.FOCAL_LENGTH_RADIAL_DISTORTION
    summary = pytheia.sfm.GlobalReconstructionEstimator(options).Estimate(graph, model)
    if not summary.success:
        sys.exit("Theia finds no reconstruction")
    output.mkdir(parents=True, exist_ok=True)
    pytheia.io.WriteColmapFiles(model, str(output))


def main() -> None:
    """Reads the arguments."""
    database, output, *given = sys.argv[1:]
    reconstruct(Path(database), Path(output), [float(v) for v in given[0].split(",")] if given and given[0] else None)


if __name__ == "__main__":
    main()
