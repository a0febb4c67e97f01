"""Computes the figures of `tractrix compare A B --json` once more, with numpy and pycolmap.

    python scripts/benchmark/check_compare.py A B comparison.json

A and B are COLMAP models without lost cameras; the JSON is that of the same two. Exit code 1 where a figure differs by
more than 1e-9 of itself.
"""

import json
import sys

import numpy as np
import pycolmap
from numpy.typing import NDArray

# Rotation and translation of a camera from the world.
Pose = tuple[NDArray, NDArray]

LIMITS_DEG = (0.5, 1.0, 3.0, 5.0, 10.0)
TOLERANCE = 1e-9


def cameras(model: pycolmap.Reconstruction) -> dict[str, Pose]:
    """Rotation and translation of each registered image, camera from world."""
    poses = {}
    for image in model.images.values():
        if image.has_pose:
            pose = image.cam_from_world()
            poses[image.name] = (pose.rotation.matrix(), pose.translation)
    return poses


def similarity(source: NDArray, target: NDArray) -> tuple[float, NDArray, NDArray]:
    """Scale, rotation and translation by Umeyama, target from source."""
    source_mean, target_mean = source.mean(0), target.mean(0)
    covariance = (target - target_mean).T @ (source - source_mean) / len(source)
    u, singular, v_t = np.linalg.svd(covariance)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v_t))])
    rotation = u @ sign @ v_t
    scale = np.trace(np.diag(singular) @ sign) / ((source - source_mean) ** 2).sum(1).mean()
    return scale, rotation, target_mean - scale * rotation @ source_mean


def angle_deg(rotation: NDArray) -> float:
    """Angle of a rotation, degrees, also exact for small ones."""
    axis = [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    return np.degrees(np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1.0))


def relative_errors(ours: list[Pose], theirs: list[Pose]) -> NDArray:
    """The larger angle of rotation and direction of translation, for every pair of images, degrees."""

    def relative(poses: list[Pose], i: int, j: int) -> Pose:
        rotation = poses[j][0] @ poses[i][0].T
        return rotation, poses[j][1] - rotation @ poses[i][1]

    errors = []
    for i in range(len(ours)):
        for j in range(i + 1, len(ours)):
            (r_a, t_a), (r_b, t_b) = relative(ours, i, j), relative(theirs, i, j)
            turned = np.degrees(np.arctan2(np.linalg.norm(np.cross(t_a, t_b)), t_a @ t_b))
            errors.append(max(angle_deg(r_a @ r_b.T), turned))
    return np.array(errors)


def reprojection(model: pycolmap.Reconstruction) -> dict[str, float]:
    """Mean error over observations and over points, pixels."""
    all_errors, per_point = [], []
    for point in model.points3D.values():
        errors = []
        for element in point.track.elements:
            image = model.images[element.image_id]
            seen = image.points2D[element.point2D_idx].xy
            errors.append(np.linalg.norm(image.project_point(point.xyz) - seen))
        all_errors += errors
        per_point.append(np.mean(errors))
    return {"mean_px": np.mean(all_errors), "mean_per_point_px": np.mean(per_point)}


def figures(model_a: pycolmap.Reconstruction, model_b: pycolmap.Reconstruction) -> dict[str, float]:
    """Every figure that is checked, by its place in the JSON."""
    a, b = cameras(model_a), cameras(model_b)
    names = sorted(set(a) & set(b))
    ours, theirs = [a[name] for name in names], [b[name] for name in names]
    centers = [np.array([-r.T @ t for r, t in poses]) for poses in (ours, theirs)]
    scale, rotation, translation = similarity(centers[1], centers[0])
    moved = scale * centers[1] @ rotation.T + translation
    rmse = np.sqrt(((moved - centers[0]) ** 2).sum(1).mean())
    angles = [angle_deg(r_b @ rotation.T @ r_a.T) for (r_a, _), (r_b, _) in zip(ours, theirs, strict=True)]
    errors = relative_errors(ours, theirs)
    found = {
        "others/0/alignment/reference_from_other/scale": scale,
        "others/0/cameras/center_rmse": rmse,
        "others/0/cameras/rotation_mean_deg": np.mean(angles),
        "others/0/cameras/rotation_max_deg": np.max(angles),
    }
    for k, limit in enumerate(LIMITS_DEG):
        found[f"others/0/relative/auc/{k}"] = np.maximum(0.0, limit - errors).mean() / limit
    for place, model in (("reference", model_a), ("others/0/subject", model_b)):
        for name, value in reprojection(model).items():
            found[f"{place}/figures/reprojection/{name}"] = value
    return found


def main() -> None:
    """Prints each figure, what the program says, and the difference."""
    path_a, path_b, path = sys.argv[1:4]
    with open(path, encoding="utf-8") as file:
        said = json.load(file)
    worst = 0.0
    for place, value in figures(pycolmap.Reconstruction(path_a), pycolmap.Reconstruction(path_b)).items():
        node = said
        for key in place.split("/"):
            node = node[int(key)] if isinstance(node, list) else node[key]
        difference = abs(node - value) / max(abs(value), 1e-300)
        worst = max(worst, difference)
        print(f"{place:50}  {value:.12g}  {node:.12g}  {difference:.1e}")
    print(f"largest difference: {worst:.1e}")
    sys.exit(0 if worst < TOLERANCE else 1)


if __name__ == "__main__":
    main()
