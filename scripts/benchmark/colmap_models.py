#!/usr/bin/env python3
"""COLMAP's reconstructions of ground-truth sequences: background and target, with the given masks and the true K.

    python3 -m venv VENV && VENV/bin/pip install pycolmap==4.2.1
    VENV/bin/python scripts/benchmark/colmap_models.py SEQUENCE... --output DIR [--first-octave 0] [--growth 0]
                                                       [--matching exhaustive] [--threads 1]

Needs pycolmap and the program ffmpeg. For every sequence DIR/<sequence>/ holds `background/` and `object/` (COLMAP
binary models, absent where COLMAP made none) and `colmap.json`: settings, registered frames, points, CPU seconds per
stage, and the RMSE of the camera centres after the best similarity to the truth. A sequence that has its `colmap.json`
is passed over; one that was interrupted begins again. Images are named as `tractrix run` names the frames of a video,
so that its `--background-model` and `--object-model 1=` take the models.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap

BACKGROUND, TARGET = 0, 1


def cpu_seconds() -> float:
    """CPU seconds of this process and its finished children so far."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def image_name(frame: dict) -> str:
    """The name under which tractrix knows a frame of a video."""
    return f"{frame['index']:06d}.jpg"


def decode(sequence: Path, scene: dict, folder: Path) -> None:
    """Writes the frames of scene.json as pictures, from the video, or from images/ where there is none."""
    folder.mkdir()
    video = sequence / "video.mp4"
    if not video.is_file():
        for frame in scene["frames"]:
            shutil.copyfile(sequence / frame["image"], folder / image_name(frame))
        return
    command = ["ffmpeg", "-loglevel", "error", "-i", str(video), "-vsync", "0", "-start_number", "0"]
    subprocess.run([*command, "-qscale:v", "1", "-qmin", "1", str(folder / "%06d.jpg")], check=True)
    wanted = {image_name(frame) for frame in scene["frames"]}
    missing = sorted(wanted - set(os.listdir(folder)))
    if missing:
        raise ValueError(f"{video}: holds no frame {missing[0][:6]}, which scene.json names")
    for extra in set(os.listdir(folder)) - wanted:
        (folder / extra).unlink()


def grown(area: np.ndarray, radius: int) -> np.ndarray:
    """A boolean image with every area grown by ``radius`` pixels, in a square."""
    out = area
    for axis in (0, 1):
        padding = [(radius, radius) if k == axis else (0, 0) for k in (0, 1)]
        padded = np.pad(out, padding)
        out = np.lib.stride_tricks.sliding_window_view(padded, 2 * radius + 1, axis=axis).any(axis=-1)
    return out


def write_masks(sequence: Path, scene: dict, label: int, growth: float, folder: Path) -> None:
    """COLMAP masks, white where features are looked for: on the pixels that carry ``label``.

    What moves is grown by ``growth`` of the longer side for the background, as ``tractrix run`` does it.
    """
    folder.mkdir()
    for frame in scene["frames"]:
        labels = pycolmap.Bitmap.read(str(sequence / frame["mask"]), False)
        if labels is None:
            raise ValueError(f"{sequence / frame['mask']}: missing or not a picture")
        values = np.squeeze(labels.to_array())
        chosen = values == label
        if label == BACKGROUND and growth > 0:
            chosen = ~grown(~chosen, round(growth * max(values.shape)))
        white = np.ascontiguousarray(chosen.astype(np.uint8) * 255)
        pycolmap.Bitmap.from_array(white).write(str(folder / f"{image_name(frame)}.png"))


def options_of(scene: dict, masks: Path, settings: dict) -> tuple:
    """Reader, extraction and mapping options: COLMAP's own, but for the masks, the fixed K, and what was asked for."""
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model, reader.mask_path = "PINHOLE", str(masks)
    (fx, _, cx), (_, fy, cy), _ = scene["K"]
    reader.camera_params = ",".join(str(float(v)) for v in (fx, fy, cx, cy))
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.sift.first_octave = settings["threads"], settings["first_octave"]
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.num_threads, mapping.random_seed = settings["threads"], 0
    mapping.ba_refine_focal_length = mapping.ba_refine_principal_point = mapping.ba_refine_extra_params = False
    mapping.mapper.abs_pose_refine_focal_length = mapping.mapper.abs_pose_refine_extra_params = False
    return reader, extraction, mapping


def reconstruct(scene: dict, images: Path, masks: Path, work: Path, settings: dict) -> tuple:
    """The largest model COLMAP makes (or None) and the CPU seconds of its stages."""
    work.mkdir()
    database = work / "database.db"
    reader, extraction, mapping = options_of(scene, masks, settings)
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = settings["threads"]
    match = {"sequential": pycolmap.match_sequential, "exhaustive": pycolmap.match_exhaustive}[settings["matching"]]
    cpu = pycolmap.Device.cpu
    models = {}
    stages = {
        "features": lambda: pycolmap.extract_features(
            database,
            images,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=extraction,
            device=cpu,
        ),
        "matching": lambda: match(database, matching_options=matching, device=cpu),
        "mapping": lambda: models.update(pycolmap.incremental_mapping(database, images, work, mapping)),
    }
    seconds = {}
    for name, stage in stages.items():
        before = cpu_seconds()
        stage()
        seconds[name] = round(cpu_seconds() - before, 2)
    best = max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()), default=None)
    return best, seconds, len(models)


def similarity_rmse(points: np.ndarray, truth: np.ndarray) -> float:
    """RMSE of points (N, 3) after the similarity that brings them closest to the truth (Umeyama)."""
    p, q = points - points.mean(0), truth - truth.mean(0)
    u, d, vt = np.linalg.svd(q.T @ p / len(p))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(d) @ sign) / (p**2).sum(1).mean()
    return float(np.sqrt(((q - scale * p @ (u @ sign @ vt).T) ** 2).sum(1).mean()))


def described(model: pycolmap.Reconstruction | None, scene: dict, label: int) -> dict:
    """Figures of one model."""
    n_frames = len(scene["frames"])
    if model is None:
        return {"registered": 0, "registered_fraction": 0.0, "points": 0}
    frames = {image_name(frame): frame for frame in scene["frames"]}
    centres, truth = [], []
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        world_from_camera = np.array(frames[image.name]["T_world_camera"])
        world_from_reference = np.eye(4) if label == BACKGROUND else np.array(frames[image.name]["T_world_object"])
        centres.append(image.projection_center())
        truth.append((np.linalg.inv(world_from_reference) @ world_from_camera)[:3, 3])
    long_enough = sum(point.track.length() >= 3 for point in model.points3D.values())
    return {
        "registered": len(centres),
        "registered_fraction": round(len(centres) / n_frames, 4),
        "points": model.num_points3D(),
        "points_track_3": long_enough,
        "mean_reprojection_error_px": round(model.compute_mean_reprojection_error(), 4),
        "camera_rmse_m": round(similarity_rmse(np.array(centres), np.array(truth)), 5),
    }


def run(sequence: Path, folder: Path, settings: dict) -> dict:
    """Both reconstructions of one sequence; returns what colmap.json holds."""
    scene = json.loads((sequence / "scene.json").read_text())
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    decode(sequence, scene, work / "images")
    result = {"sequence": sequence.name, "frames": len(scene["frames"]), "pycolmap": pycolmap.__version__, **settings}
    for name, label in (("background", BACKGROUND), ("object", TARGET)):
        masks = work / f"{name}_masks"
        write_masks(sequence, scene, label, settings["growth"], masks)
        model, seconds, n_models = reconstruct(scene, work / "images", masks, work / name, settings)
        shutil.rmtree(folder / name, ignore_errors=True)
        if model is not None:
            (folder / name).mkdir()
            model.write(folder / name)
        result[name] = {**described(model, scene, label), "models": n_models, "cpu_s": seconds}
    result["cpu_s"] = round(sum(sum(result[name]["cpu_s"].values()) for name in ("background", "object")), 1)
    partial = folder / "colmap.partial.json"
    partial.write_text(json.dumps(result, indent=1) + "\n")
    partial.replace(folder / "colmap.json")
    shutil.rmtree(work)
    return result


def main() -> None:
    """Makes the models of the sequences given, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="+", type=Path, help="folders with a scene.json")
    parser.add_argument("--output", type=Path, required=True, help="folder of the models")
    parser.add_argument(
        "--first-octave", type=int, default=-1, help="of SIFT; COLMAP's own is -1, 0 is 3-5 times faster"
    )
    parser.add_argument(
        "--growth",
        type=float,
        default=0.005,
        help="by how much the masks of what moves are grown for the background, as a share of the longer side; the "
        "default is that of `tractrix run`",
    )
    parser.add_argument(
        "--matching",
        choices=("sequential", "exhaustive"),
        default="sequential",
        help="pairs of frames that are compared",
    )
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    settings = {name: getattr(arguments, name) for name in ("first_octave", "growth", "matching", "threads")}
    failed = []
    for sequence in arguments.sequences:
        sequence = sequence.resolve()
        folder = arguments.output / sequence.name
        try:
            done = folder / "colmap.json"
            fresh = not done.is_file()
            result = run(sequence, folder, settings) if fresh else json.loads(done.read_text())
            for name in ("first_octave", "growth", "matching"):
                before = result.get(name, "sequential" if name == "matching" else None)
                if before != settings[name]:
                    raise ValueError(f"{done}: was made with {name} {before}; choose another --output")
        except (OSError, KeyError, ValueError, subprocess.CalledProcessError) as error:
            failed.append(sequence.name)
            print(f"{sequence.name}: {error}", file=sys.stderr, flush=True)
            continue
        parts = [f"{n} {result[n]['registered']}/{result['frames']}" for n in ("background", "object")]
        print(
            f"{sequence.name}: {', '.join(parts)}, {result['cpu_s']:.0f} CPU s{'' if fresh else ' (there)'}", flush=True
        )
    if failed:
        sys.exit(f"no models of: {', '.join(failed)}")


if __name__ == "__main__":
    main()
