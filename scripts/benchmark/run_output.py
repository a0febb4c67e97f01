"""An output folder of `tractrix run` as a stranger reads it: docs/formats.md is all that is known of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

Box = tuple[int, int, int, int]


def box_of(mask: np.ndarray) -> Box | None:
    """The smallest box (x0, y0, x1, y1, half open) round the set pixels of a boolean image."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def box_iou(a: Box | np.ndarray, b: Box | np.ndarray) -> float:
    """Intersection over union of two boxes (x0, y0, x1, y1)."""
    common = max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    both = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common
    return common / both if both > 0 else 0.0


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; an empty one where there is no such file."""
    return json.loads(path.read_text()) if path.is_file() else {}


class RunOutput:
    """Tracks, trajectories and cost of one run; what is missing is empty."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.run = read_json(folder / "run.json")
        self.objects = {entry["id"]: entry for entry in read_json(folder / "trajectories.json").get("objects", [])}
        self.tracked = {entry["id"]: entry for entry in read_json(folder / "tracks.json").get("objects", [])}

    @property
    def ids(self) -> list[int]:
        """Ids of all tracks, with and without a trajectory."""
        folders = self.folder.glob("tracks/*")
        return sorted(int(f.name) for f in folders if f.name.isdigit() and any(f.glob("*.png")))

    def names(self, track: int) -> list[str]:
        """Names of the images in which a track has a mask."""
        return sorted(path.name.removesuffix(".png") for path in (self.folder / f"tracks/{track}").glob("*.png"))

    def mask(self, track: int, name: str) -> np.ndarray | None:
        """A track's pixels in an image; None where it has no mask there."""
        path = self.folder / f"tracks/{track}/{name}.png"
        return np.asarray(Image.open(path)) > 0 if path.is_file() else None

    def boxes(self, track: int) -> dict[str, Box]:
        """A track's box in every image in which it has a mask."""
        found = {name: box_of(self.mask(track, name)) for name in self.names(track)}
        return {name: box for name, box in found.items() if box}

    def said(self, track: int) -> dict[str, Any]:
        """What the program says of a track: class, what found it, whether it moved; None for what it does not say."""
        tracked = self.tracked.get(track, {})
        found_in = {finder: frames for finder, frames in tracked.get("found_in", {}).items() if frames}
        return {
            "class": tracked.get("class") or self.objects.get(track, {}).get("class"),
            "finder": found_in or None,
            "movement": tracked.get("movement", {}).get("state"),
            "left_out": tracked.get("left_out"),
            "trajectory": track in self.objects,
        }

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the frames as they were used."""
        info = self.run["input"]["info"]
        return info["width"], info["height"]

    @property
    def num_frames(self) -> int:
        """Frames that were used."""
        figures = self.run.get("stages", {}).get("frames", {}).get("figures") or {}
        return int(figures.get("num_frames", 0))

    def cost(self) -> dict[str, Any]:
        """CPU seconds, in all and by stage, and peak memory (MiB)."""
        stages = self.run.get("stages", {})
        by_stage = {name: stage.get("cpu_s", 0.0) for name, stage in stages.items()}
        peak = max((stage.get("peak_rss_mib") or 0.0 for stage in stages.values()), default=0.0)
        return {"cpu_s": sum(by_stage.values()), "stages_cpu_s": by_stage, "peak_rss_mib": peak}
