"""MobileSAM as teacher: the mask of a box by the files in `models/`, chosen as `src/networks/prompt` chooses."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from crops import iou

MODELS = Path(__file__).resolve().parents[2]
MEAN, STD = np.array([123.675, 116.28, 103.53]), np.array([58.395, 57.12, 57.375])
AGREEMENT = 0.75


def session(path: Path, threads: int = 1) -> onnxruntime.InferenceSession:
    """A session on the processor."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = threads
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


class Teacher:
    """Encoder and decoder; `side` is the longer side of the input, `window` is in longer sides of the box."""

    def __init__(self, side: int = 448, window: float = 2.0, models: Path = MODELS) -> None:
        self.side, self.window = side, window
        self.encoder = session(models / "mobile_sam_encoder.onnx")
        self.decoder = session(models / "mobile_sam_decoder.onnx")

    def logits(self, image: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Logits, their area (x0, y0, x1, y1) in the RGB image, and the quality of the best mask of a box."""
        height, width = image.shape[:2]
        half = 0.5 * self.window * max(box[2] - box[0], box[3] - box[1])
        half = max(half, 28.0)
        x, y = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
        x0, y0 = int(max(0, np.floor(x - half))), int(max(0, np.floor(y - half)))
        x1, y1 = int(min(width, np.ceil(x + half))), int(min(height, np.ceil(y + half)))
        if x1 - x0 < 4 or y1 - y0 < 4:
            return None
        scale = self.side / max(x1 - x0, y1 - y0)
        size = (max(1, round((x1 - x0) * scale)), max(1, round((y1 - y0) * scale)))
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        part = cv2.resize(image[y0:y1, x0:x1], size, interpolation=interpolation)
        padded = [-(-s // 16) * 16 for s in size]
        tensor = np.zeros((1, 3, padded[1], padded[0]), np.float32)
        tensor[0, :, : size[1], : size[0]] = ((part - MEAN) / STD).transpose(2, 0, 1)
        (embedding,) = self.encoder.run(None, {"image": tensor})
        scales = np.array([size[0] / (x1 - x0), size[1] / (y1 - y0)])
        corners = ((box.reshape(2, 2) - (x0, y0)) * scales - 0.5).astype(np.float32)[None]
        prompt = {"embedding": embedding, "points": corners, "labels": np.array([[2, 3]], np.float32)}
        masks, scores = self.decoder.run(None, prompt)
        best = None
        for logits, score in zip(masks[0], scores[0]):
            inside = logits > 0
            stable = (logits > 1).sum() / max(1, (logits > -1).sum())
            rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
            if len(rows) == 0:
                continue
            own = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]) * 4.0
            asked = (box.reshape(2, 2) - (x0, y0)) * scales
            quality = min(1.0, float(score)) * stable * min(1.0, iou(own, asked.ravel()) / AGREEMENT)
            if best is None or quality > best[1]:
                best = (logits, quality)
        if best is None:
            return None
        area = np.array([x0, y0, x0 + padded[0] / scales[0], y0 + padded[1] / scales[1]])
        return best[0], area, float(best[1])

    def probability(self, image: np.ndarray, box: np.ndarray) -> tuple[np.ndarray, float] | None:
        """Probability of the object per pixel of the image, and the quality."""
        found = self.logits(image, box)
        if found is None:
            return None
        logits, area, quality = found
        height, width = image.shape[:2]
        step = np.array([(area[2] - area[0]) / logits.shape[1], (area[3] - area[1]) / logits.shape[0]])
        xs = ((np.arange(width) + 0.5 - area[0]) / step[0] - 0.5).astype(np.float32)
        ys = ((np.arange(height) + 0.5 - area[1]) / step[1] - 0.5).astype(np.float32)
        grid = np.meshgrid(xs, ys)
        outside = -20.0
        sampled = cv2.remap(logits, *grid, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
        # The object ends with the part that was looked at and near its box.
        grown = 0.15 * max(box[2] - box[0], box[3] - box[1])
        x0, y0, x1, y1 = box + (-grown, -grown, grown, grown)
        beyond = (xs * step[0] + area[0] < x0) | (xs * step[0] + area[0] > x1)
        sampled[:, beyond] = outside
        beyond = (ys * step[1] + area[1] < y0) | (ys * step[1] + area[1] > y1)
        sampled[beyond] = outside
        return 1 / (1 + np.exp(-sampled)), quality
