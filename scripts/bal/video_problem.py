#!/usr/bin/env python3
"""A problem of "Bundle Adjustment in the Large" as a long video makes it: cameras share points with neighbours only.

    scripts/bal/video_problem.py NUM_CAMERAS NUM_POINTS OUT.txt       (needs numpy)

A camera flies past a wall of points, 0.3 units from frame to frame, swaying a little. Pixels have half a pixel of
noise; poses, focal lengths and points start beside the truth. The seed is fixed: the same arguments give the same file.
"""

import sys

import numpy as np

FOCAL, HALF_WIDTH, HALF_HEIGHT, STEP = 800.0, 400.0, 270.0, 0.3


def observe(
    rotation: np.ndarray, center: np.ndarray, points: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Indices and pixels of the points in view; the camera looks along its negative z, as in this format."""
    in_cam = (points - center) @ rotation.T
    pixels = -FOCAL * in_cam[:, :2] / in_cam[:, 2:]
    seen = (in_cam[:, 2] < -1) & (np.abs(pixels) < [HALF_WIDTH, HALF_HEIGHT]).all(axis=1)
    index = np.flatnonzero(seen)
    return index, pixels[index] + rng.normal(scale=0.5, size=(len(index), 2))


def main() -> None:
    num_cameras, num_points, out = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    rng = np.random.default_rng(1)
    x = STEP * np.arange(num_cameras)
    centers = np.stack([x, 0.5 * np.sin(x / 7), 0.8 * np.cos(x / 11)], axis=1)
    angles = 0.1 * np.sin(x / 9)
    points = rng.uniform([-3, -3, -14], [x[-1] + 3, 3, -6], size=(num_points, 3))
    observations, cameras = [], []
    for k, (center, angle) in enumerate(zip(centers, angles)):
        cos, sin = np.cos(angle), np.sin(angle)
        rotation = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
        index, pixels = observe(rotation, center, points, rng)
        observations += [(j, k, u, v) for j, (u, v) in zip(index, pixels)]
        translation = -rotation @ center + rng.normal(scale=0.02, size=3)
        cameras.append(
            [0, angle + rng.normal(scale=0.002), 0, *translation, FOCAL * (1 + rng.normal(scale=0.01)), 0, 0]
        )
    count = np.bincount([o[0] for o in observations], minlength=num_points)
    place = np.cumsum(count >= 2) - 1
    kept = sorted(o for o in observations if count[o[0]] >= 2)
    starts = (points + rng.normal(scale=0.05, size=points.shape))[count >= 2]
    with open(out, "w") as file:
        file.write(f"{num_cameras} {len(starts)} {len(kept)}\n")
        file.writelines(f"{k} {place[j]} {u:.6f} {v:.6f}\n" for j, k, u, v in kept)
        file.writelines(f"{value:.10g}\n" for block in (*cameras, *starts) for value in block)
    print(f"{num_cameras} cameras, {len(starts)} points, {len(kept)} observations")


if __name__ == "__main__":
    main()
