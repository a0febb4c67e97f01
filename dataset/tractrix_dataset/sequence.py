"""One sequence from beginning to end; can be stopped at any moment and goes on where it was."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import cv2

from . import labels, truth
from .drives import FPS
from .render import RenderOptions, render_frame, set_up
from .scene import Request, build_world

VIDEO_QUALITIES = (16, 18, 20, 22, 24, 26)


def finished(folder: Path) -> bool:
    """Whether a sequence is whole: scene.json is written last."""
    return (folder / "scene.json").is_file()


def _encode_at(work: Path, video: Path, crf: int) -> None:
    """Encodes the frames as H.264 at one quality."""
    color = ["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709"]
    command = ["ffmpeg", "-y", "-loglevel", "error", "-framerate", f"{FPS:g}", "-i", str(work / "%05d.png")]
    command += ["-c:v", "libx264", "-preset", "veryslow", "-crf", str(crf), "-pix_fmt", "yuv420p", *color]
    command += ["-vf", "scale=out_color_matrix=bt709", "-movflags", "+faststart", str(video)]
    subprocess.run(command, check=True)


def first_fitting(qualities: tuple[int, ...], fits: Callable[[int], bool]) -> int:
    """The first quality that fits, or the last one; sizes fall from first to last, so halves are left out."""
    low, high = 0, len(qualities) - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if fits(qualities[middle]) else (middle + 1, high)
    return qualities[low]


def _encode(work: Path, video: Path, max_bytes: int) -> int:
    """Encodes the frames as H.264 at the best quality that fits; returns the quality (crf)."""

    def at(crf: int) -> Path:
        return work / f"video_{crf}.mp4"

    def fits(crf: int) -> bool:
        _encode_at(work, at(crf), crf)
        return at(crf).stat().st_size <= max_bytes

    best = first_fitting(VIDEO_QUALITIES, fits)
    if not at(best).is_file():
        _encode_at(work, at(best), best)
    at(best).replace(video)
    return best


def _check_request(folder: Path, request: Request, options: RenderOptions) -> None:
    """Stops when the folder was begun with other options."""
    wanted = {
        "trajectory": request.trajectory,
        "vehicle": request.vehicle,
        "seed": request.seed,
        "frames": request.n_frames,
        "width": options.width,
        "height": options.height,
        "samples": options.samples,
    }
    path = folder / "work" / "request.json"
    if path.is_file() and json.loads(path.read_text()) != wanted:
        raise SystemExit(f"{folder}: was begun with other options ({path}); remove the folder or choose another")
    path.write_text(json.dumps(wanted))


def render_sequence(request: Request, options: RenderOptions, folder: Path, max_bytes: int, images: bool) -> None:
    """Renders what is missing of a sequence and writes its ground truth.

    ``max_bytes`` bounds the whole folder (without images); the video's
    quality is lowered until it fits.
    """
    if finished(folder):
        return
    work = folder / "work"
    for name in ("work", "semantic", "masks"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    _check_request(folder, request, options)
    started = time.monotonic()
    world = build_world(request)
    truth.write_meshes(world, folder)
    device = set_up(world, options, work)
    print(f"{request.name}: scene built in {time.monotonic() - started:.0f} s, rendering on {device}", flush=True)
    for index in range(request.n_frames):
        image, semantic = work / f"{index:05d}.png", folder / "semantic" / f"{index:05d}.png"
        if not image.is_file():
            render_frame(world, index, image, semantic, work)
            done = f"{request.name}: frame {index + 1}/{request.n_frames}"
            print(f"{done}, {time.monotonic() - started:.0f} s", flush=True)
        semantic_map = cv2.imread(str(semantic), cv2.IMREAD_GRAYSCALE)
        labels.write_png(folder / "masks" / f"{index:05d}.png", labels.mask_of(semantic_map))
    content = truth.scene_json(world, options, device, folder)
    _finish(folder, work, content, max_bytes, images)


def _finish(folder: Path, work: Path, content: dict, max_bytes: int, images: bool) -> None:
    """Encodes the video, writes scene.json and removes the scratch folder."""
    rest = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file() and work not in p.parents)
    rest += len(json.dumps(content))
    content["video_crf"] = _encode(work, folder / "video.mp4", max_bytes - rest)
    if images:
        (folder / "images").mkdir(exist_ok=True)
        for frame in content["frames"]:
            picture = cv2.imread(str(work / f"{frame['index']:05d}.png"))
            cv2.imwrite(str(folder / frame["image"]), picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    truth.write_json(folder / "scene.json", content)
    shutil.rmtree(work)
