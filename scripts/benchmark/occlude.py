#!/usr/bin/env python3
"""Puts something before the target of a rendered sequence: the same frames and truth, with an occluder in them.

    scripts/benchmark/occlude.py post SEQUENCE --output DIR [--frame 30] [--hidden 8]
    scripts/benchmark/occlude.py lorry SEQUENCE --output DIR [--first 20] [--last 44]
    scripts/benchmark/occlude.py sweep SEQUENCE --other SEQUENCE --output DIR [--first 18] [--last 44] [--cover 0.6]

`post`: a textured board stands in the world between the camera and the target, so wide that the target is hidden in
at least --hidden frames. `lorry`: a textured box passes before the target and hides all of it. `sweep`: the vehicle of
another sequence passes before the lower part of the target, as high as --cover of it. DIR gets video.mp4, masks,
semantic and scene.json as SEQUENCE has them, so that `perception.py rendered`, `tractrix benchmark` and `tractrix
evaluate` read it; masks have 2 where an occluder is a vehicle, else 0, and semantic has 0. Needs numpy, OpenCV and the
program ffmpeg. The same arguments give the same frames.
"""

import argparse
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np

Image = np.ndarray
TARGET, VEHICLE = 1, 2
NO_LABEL = 0
LEAST_VISIBLE = 0.05


class Sequence:
    """A rendered sequence in memory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scene: dict[str, Any] = json.loads((folder / "scene.json").read_text())
        video, decoded = cv2.VideoCapture(str(folder / "video.mp4")), []
        while True:
            is_frame, picture = video.read()
            if not is_frame:
                break
            decoded.append(picture)
        frames = self.scene["frames"]
        self.pictures: list[Image] = [decoded[frame.get("video_frame", frame["index"])] for frame in frames]
        self.labels: list[Image] = [cv2.imread(str(folder / frame["mask"]), 0) for frame in frames]
        self.semantic: list[Image] = [cv2.imread(str(folder / frame["semantic"]), 0) for frame in frames]

    def write(self, folder: Path) -> None:
        """Writes it elsewhere; what does not change is linked."""
        shutil.rmtree(folder, ignore_errors=True)
        for kind in ("masks", "semantic"):
            (folder / kind).mkdir(parents=True)
        size = f"{self.scene['width']}x{self.scene['height']}"
        encode = ["ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "bgr24", "-s", size]
        encode += ["-r", str(self.scene["fps"]), "-i", "-", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p"]
        data = b"".join(picture.tobytes() for picture in self.pictures)
        subprocess.run([*encode, "-threads", "1", folder / "video.mp4"], input=data, check=True)
        for index, (frame, labels, semantic) in enumerate(zip(self.scene["frames"], self.labels, self.semantic)):
            frame["mask"], frame["semantic"] = f"masks/{index:05d}.png", f"semantic/{index:05d}.png"
            frame["video_frame"] = index
            cv2.imwrite(str(folder / frame["mask"]), labels)
            cv2.imwrite(str(folder / frame["semantic"]), semantic)
        for name in ("object_mesh.ply", "ground_mesh.ply"):
            os.symlink((self.folder / name).resolve(), folder / name)
        (folder / "scene.json").write_text(json.dumps(self.scene))

    def paint(self, index: int, picture: Image, where: Image, label: int) -> None:
        """Replaces pixels of a frame."""
        self.pictures[index] = np.where(where[:, :, None], picture, self.pictures[index])
        self.labels[index] = np.where(where, label, self.labels[index]).astype(np.uint8)
        self.semantic[index] = np.where(where, NO_LABEL, self.semantic[index]).astype(np.uint8)


def texture(height: int, width: int, seed: int, colour: tuple[int, int, int]) -> Image:
    """Noise at all scales over a colour."""
    random = np.random.default_rng(seed)
    picture = np.zeros((height, width, 3), np.float32) + np.array(colour, np.float32)
    for step in (4, 8, 16, 32, 64):
        noise = random.normal(size=(max(2, height // step), max(2, width // step))).astype(np.float32)
        picture += 14 * cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)[:, :, None]
    return np.clip(picture, 0, 255).astype(np.uint8)


def box_of(labels: Image) -> tuple[int, int, int, int] | None:
    """Left, right, top and bottom of the target."""
    rows, columns = np.nonzero(labels == TARGET)
    return (columns.min(), columns.max(), rows.min(), rows.max()) if len(rows) else None


def board(sequence: Sequence, frame: int, width_m: float) -> list[tuple[Image, Image] | None]:
    """Corners and pixels of a board before the target of one frame, in every frame that sees it."""
    frames, intrinsics = sequence.scene["frames"], np.array(sequence.scene["K"])
    camera = np.array(frames[frame]["T_world_camera"])[:3, 3]
    target = np.array(frames[frame]["T_world_object"])[:3, 3] + [0, 0, 0.8]
    middle, ray = camera + 0.6 * (target - camera), target - camera
    side, up = np.cross(ray, [0, 0, 1]), np.array([0, 0, 8.0])
    side = side / np.linalg.norm(side) * width_m / 2
    corners = np.array([middle - side - up, middle + side - up, middle + side + up, middle - side + up])
    seen: list[tuple[Image, Image] | None] = []
    for one, labels in zip(frames, sequence.labels):
        pose = np.linalg.inv(np.array(one["T_world_camera"]))
        in_camera = corners @ pose[:3, :3].T + pose[:3, 3]
        if (in_camera[:, 2] < 0.3).any():
            seen.append(None)
            continue
        projected = in_camera @ intrinsics.T
        pixels, where = (projected[:, :2] / projected[:, 2:]).astype(np.float32), np.zeros(labels.shape, np.uint8)
        cv2.fillConvexPoly(where, np.round(8 * pixels).astype(np.int32), 1, shift=3)
        seen.append((pixels, where > 0))
    return seen


def num_hidden(sequence: Sequence, seen: list[tuple[Image, Image] | None]) -> int:
    """Frames in which hardly anything of the target is left."""

    def visible(labels: Image, place: tuple[Image, Image] | None) -> float:
        target = labels == TARGET
        return 1.0 if place is None else np.count_nonzero(target & ~place[1]) / max(np.count_nonzero(target), 1)

    return sum(visible(labels, place) < LEAST_VISIBLE for labels, place in zip(sequence.labels, seen))


def add_post(sequence: Sequence, frame: int, hidden: int) -> None:
    """The narrowest board that hides the target in so many frames."""
    widths = [0.3 * 1.15**k for k in range(29)]
    seen = next((s for s in (board(sequence, frame, w) for w in widths) if num_hidden(sequence, s) >= hidden), None)
    if seen is None:
        raise SystemExit(f"{sequence.folder}: no board before frame {frame} hides the target in {hidden} frames")
    picture = texture(2048, 512, 1, (50, 80, 70))
    height, width = picture.shape[:2]
    size = (sequence.scene["width"], sequence.scene["height"])
    own = np.array([[0, height], [width, height], [width, 0], [0, 0]], np.float32)
    for index, place in enumerate(seen):
        if place is not None:
            warp = cv2.getPerspectiveTransform(own, place[0])
            sequence.paint(index, cv2.warpPerspective(picture, warp, size), place[1], 0)


def add_passing(sequence: Sequence, other: Sequence | None, first: int, last: int, cover: float) -> None:
    """Something that passes from left to right: the other sequence's vehicle, or a textured box."""
    middle = box_of(sequence.labels[(first + last) // 2])
    if middle is None:
        raise SystemExit(f"{sequence.folder}: the target is not seen in the middle of the frames")
    width, height = int(middle[1] - middle[0]), int(middle[3] - middle[2])
    lorry = texture(2 * height, int(2.2 * width), 3, (140, 140, 150))
    for index in range(first, last):
        box, along = box_of(sequence.labels[index]), 2 * (index - first) / (last - 1 - first) - 1
        if box is None:
            continue
        x, y = (box[0] + box[1]) / 2, (box[2] + box[3]) / 2
        if other is None:
            picture, inside, x = lorry, np.ones(lorry.shape[:2], bool), x + 2.6 * width * along
        else:
            place = box_of(other.labels[index])
            if place is None:
                continue
            cut = np.s_[place[2] : place[3] + 1, place[0] : place[1] + 1]
            picture, inside = other.pictures[index][cut], other.labels[index][cut] == TARGET
            scale = height / picture.shape[0]
            picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            inside = cv2.resize(inside.astype(np.uint8), picture.shape[1::-1]) > 0
            x, y = x + 1.7 * width * along, y + height * (1 - cover)
        paste(sequence, index, picture, inside, (round(x - picture.shape[1] / 2), round(y - picture.shape[0] / 2)))


def paste(sequence: Sequence, index: int, picture: Image, inside: Image, corner: tuple[int, int]) -> None:
    """Paints a vehicle's pixels at a place, as far as it lies in the frame."""
    rows, columns = np.nonzero(inside)
    to_rows, to_columns = rows + corner[1], columns + corner[0]
    shape = sequence.labels[index].shape
    kept = (to_rows >= 0) & (to_columns >= 0) & (to_rows < shape[0]) & (to_columns < shape[1])
    whole, where = np.zeros((*shape, 3), np.uint8), np.zeros(shape, bool)
    whole[to_rows[kept], to_columns[kept]] = picture[rows[kept], columns[kept]]
    where[to_rows[kept], to_columns[kept]] = True
    sequence.paint(index, whole, where, VEHICLE)


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["post", "lorry", "sweep"])
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--other", type=Path)
    parser.add_argument("--frame", type=int, default=30)
    parser.add_argument("--hidden", type=int, default=8)
    parser.add_argument("--first", type=int, default=18)
    parser.add_argument("--last", type=int, default=44)
    parser.add_argument("--cover", type=float, default=0.6)
    args = parser.parse_args()
    sequence = Sequence(args.sequence)
    if args.kind == "post":
        add_post(sequence, args.frame, args.hidden)
    elif args.kind == "sweep" and args.other is None:
        parser.error("sweep needs --other")
    else:
        other = Sequence(args.other) if args.kind == "sweep" else None
        add_passing(sequence, other, args.first, args.last, args.cover)
    sequence.write(args.output)


if __name__ == "__main__":
    main()
