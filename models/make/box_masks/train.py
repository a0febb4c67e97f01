#!/usr/bin/env python3
"""Trains the box mask network on tiles; resumes from its last checkpoint.

    python train.py --tiles DIR --output DIR --seconds 420

writes checkpoint.pt, box_masks.onnx (32-bit floats) and log.txt. All augmentation runs on the device: moved boxes,
another vehicle's background, occluders, low resolution, blur, noise, light and color.
"""

from __future__ import annotations

import argparse
import copy
import json
import time
from pathlib import Path

import numpy as np
import torch
from crops import MARGIN, MAX_STRETCH, SIDE, TILE
from network import BoxMaskNet, export
from torch.nn import functional

RENDER, REAL, PHOTO, EMPTY, SYNTHETIC = range(5)
SHARES = {RENDER: 0.14, REAL: 0.25, PHOTO: 0.16, EMPTY: 0.07, SYNTHETIC: 0.38}
MOST_STEPS = 1_000_000


class Data:
    """All tiles on the device; takes up files that are written while training runs."""

    def __init__(self, folders: list[Path], device: torch.device) -> None:
        self.folders, self.device, self.known = folders, device, set()
        self.image = torch.zeros((0, TILE, TILE, 3), dtype=torch.uint8, device=device)
        self.mask = torch.zeros((0, TILE, TILE), dtype=torch.uint8, device=device)
        self.box, self.scale = torch.zeros((0, 4), device=device), torch.zeros((0, 2), device=device)
        self.kinds = np.zeros(0, np.uint8)
        self.by_kind = {}

    def refresh(self) -> None:
        """Loads new files."""
        paths = [p for folder in self.folders for p in sorted(folder.glob("*.npz")) if not p.stem.endswith(".partial")]
        parts = {name: [] for name in ("image", "mask", "box", "scale", "kind")}
        for path in [p for p in paths if p not in self.known]:
            self.known.add(path)
            with np.load(path) as content:
                for name, values in parts.items():
                    values.append(content[name])
        if not parts["kind"]:
            return
        for name in ("image", "mask", "box", "scale"):
            more = torch.from_numpy(np.concatenate(parts[name])).to(self.device)
            setattr(self, name, torch.cat([getattr(self, name), more]))
        self.kinds = np.concatenate([self.kinds, *parts["kind"]])
        self.by_kind = {k: torch.from_numpy(np.flatnonzero(self.kinds == k)).to(self.device) for k in SHARES}
        print("tiles:", {k: len(v) for k, v in self.by_kind.items()}, flush=True)


def uniform(count: int, low: float, high: float, like: torch.Tensor) -> torch.Tensor:
    """Uniform numbers on the device."""
    return torch.rand(count, device=like.device) * (high - low) + low


def crop_grid(
    box: torch.Tensor, scale: torch.Tensor, side: int, flip: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Sampling grid of the crop around a box of a tile, and the crop (x0, y0, x1, y1) in the tile's pixels."""
    width = (box[:, 2] - box[:, 0]) / scale[:, 0]
    height = (box[:, 3] - box[:, 1]) / scale[:, 1]
    half_x = 0.5 * MARGIN * torch.maximum(width, height / MAX_STRETCH) * scale[:, 0]
    half_y = 0.5 * MARGIN * torch.maximum(height, width / MAX_STRETCH) * scale[:, 1]
    x, y = 0.5 * (box[:, 0] + box[:, 2]), 0.5 * (box[:, 1] + box[:, 3])
    at = (torch.arange(side, device=box.device) + 0.5) / side * 2 - 1
    across = at[None] * flip[:, None]
    u = ((x[:, None] + half_x[:, None] * across) / TILE * 2 - 1)[:, None, :].expand(-1, side, -1)
    v = ((y[:, None] + half_y[:, None] * at[None]) / TILE * 2 - 1)[:, :, None].expand(-1, -1, side)
    return torch.stack([u, v], -1), torch.stack([x - half_x, y - half_y, x + half_x, y + half_y], 1)


def sampled(tiles: torch.Tensor, grid: torch.Tensor) -> torch.Tensor:
    """Samples tiles (n, c, h, w) at twice the resolution of the crop and averages."""
    fine = functional.grid_sample(tiles, grid, mode="bilinear", padding_mode="border", align_corners=False)
    return functional.avg_pool2d(fine, 2)


def box_channel(box: torch.Tensor, area: torch.Tensor, flip: torch.Tensor) -> torch.Tensor:
    """1 in the box, 0 around it, with the share of the pixel at its sides."""

    def along(low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
        cells = torch.arange(SIDE, device=box.device)[None]
        return (torch.minimum(high[:, None], cells + 1) - torch.maximum(low[:, None], cells)).clamp(0, 1)

    size = (area[:, 2:] - area[:, :2]) / SIDE
    low, high = (box[:, :2] - area[:, :2]) / size, (box[:, 2:] - area[:, :2]) / size
    # The box lies in the middle of its crop: a mirrored one is the same.
    return (along(low[:, 1], high[:, 1])[:, :, None] * along(low[:, 0], high[:, 0])[:, None, :])[:, None]


def blurred(image: torch.Tensor, sigma: float, direction: int = 0) -> torch.Tensor:
    """Gaussian blur; along x or y only (motion) for direction 1 or 2."""
    reach = max(1, int(3 * sigma))
    at = torch.arange(-reach, reach + 1, device=image.device, dtype=image.dtype)
    kernel = torch.exp(-0.5 * (at / sigma) ** 2)
    kernel = (kernel / kernel.sum()).expand(image.shape[1], 1, -1)
    padded = functional.pad(image, (reach,) * 4, mode="reflect")
    count = image.shape[1]
    across = kernel[:, :, None, :] if direction != 2 else torch.zeros_like(kernel[:, :, None, :])
    down = kernel[:, :, :, None] if direction != 1 else torch.zeros_like(kernel[:, :, :, None])
    if direction == 2:
        across[..., reach] = 1
    if direction == 1:
        down[:, :, reach] = 1
    return functional.conv2d(functional.conv2d(padded, across, groups=count), down, groups=count)


def with_background(image: torch.Tensor, mask: torch.Tensor, share: float) -> torch.Tensor:
    """Puts the object of some crops onto the image of another crop."""
    count = len(image)
    other = image.roll(1, 0)
    use = (torch.rand(count, device=image.device) < share).float()[:, None, None, None]
    tone = 1 + 0.25 * torch.randn(count, 1, 1, 1, device=image.device)
    shifted = other * tone
    return image * (1 - use) + use * (mask * image + (1 - mask) * shifted)


def with_occluder(image: torch.Tensor, mask: torch.Tensor, share: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Covers a band or patch of some crops with another crop's pixels: what is covered is not the object's."""
    count, side = len(image), image.shape[-1]
    at = torch.arange(side, device=image.device)[None]
    center = torch.rand(count, 2, device=image.device) * side * 0.5 + side * 0.25
    half = torch.rand(count, 2, device=image.device) ** 2 * side * 0.14 + 1
    tall = torch.rand(count, device=image.device) < 0.4
    half[:, 1] = torch.where(tall, torch.full_like(half[:, 1], side * 1.0), half[:, 1])
    inside_x = ((at - center[:, :1]).abs() < half[:, :1]).float()
    inside_y = ((at - center[:, 1:]).abs() < half[:, 1:]).float()
    use = (torch.rand(count, device=image.device) < share).float()
    cover = (inside_y[:, :, None] * inside_x[:, None, :] * use[:, None, None])[:, None]
    return image * (1 - cover) + cover * image.roll(3, 0).flip(2), mask * (1 - cover)


def colored(image: torch.Tensor) -> torch.Tensor:
    """Brightness, contrast, gamma, saturation, color of the light; some are gray."""
    count = len(image)
    column = lambda low, high: uniform(count, low, high, image)[:, None, None, None]  # noqa: E731
    image = image.clamp(0, 255) / 255
    image = image ** torch.exp(column(-0.45, 0.45))
    gains = 1 + 0.1 * torch.randn(count, 3, 1, 1, device=image.device)
    image = image * gains * torch.exp(column(-0.35, 0.25))
    gray = image.mean(1, keepdim=True)
    saturation = column(0.2, 1.5) * (torch.rand(count, 1, 1, 1, device=image.device) > 0.08)
    image = gray + (image - gray) * saturation
    mean = image.mean((1, 2, 3), keepdim=True)
    image = mean + (image - mean) * column(0.6, 1.35)
    image = image + (torch.rand(count, 1, 1, 1, device=image.device) < 0.15) * column(0.0, 0.25)
    return image.clamp(0, 1) * 255


def truncated(mask: torch.Tensor, box: torch.Tensor, share: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Puts the border of the image through some objects: what is beyond it (n, 1, h, w), boxes of what remains."""
    count, side = len(mask), mask.shape[-1]
    at = torch.arange(side, device=mask.device)[None]
    use = torch.rand(count, device=mask.device) < share
    edge = torch.randint(4, (count,), device=mask.device)
    part = uniform(count, 0.06, 0.6, mask)
    size = box[:, 2:] - box[:, :2]
    low = box[:, :2] + part[:, None] * size
    high = box[:, 2:] - part[:, None] * size
    beyond_x = ((edge == 0)[:, None] & (at < low[:, :1])) | ((edge == 2)[:, None] & (at >= high[:, :1]))
    beyond_y = ((edge == 1)[:, None] & (at < low[:, 1:])) | ((edge == 3)[:, None] & (at >= high[:, 1:]))
    beyond = beyond_x[:, None, :] | beyond_y[:, :, None]
    rest = (mask[:, 0] > 127) & ~beyond
    columns, rows = rest.any(1), rest.any(2)
    first = torch.stack([columns.float().argmax(1), rows.float().argmax(1)], 1)
    last = side - torch.stack([columns.flip(1).float().argmax(1), rows.flip(1).float().argmax(1)], 1)
    tight = torch.cat([first, last], 1).float()
    use &= rest.sum((1, 2)) > 0.15 * (mask[:, 0] > 127).sum((1, 2)).clamp(min=1)
    use &= (tight[:, 2:] - tight[:, :2]).amin(1) > 12
    return (beyond & use[:, None, None])[:, None].float(), torch.where(use[:, None], tight, box)


def batch(data: Data, count: int, augment: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
    """Inputs (n, 4, 128, 128) and targets (n, 1, 128, 128)."""
    device = data.image.device
    numbers = []
    available = {k: s for k, s in SHARES.items() if len(data.by_kind[k])}
    for kind, share in available.items():
        rows = data.by_kind[kind]
        wanted = max(1, round(count * share / sum(available.values())))
        numbers.append(rows[torch.randint(len(rows), (wanted,), device=device)])
    rows = torch.cat(numbers)
    rows = rows[torch.randperm(len(rows), device=device)]
    n = len(rows)
    tiles = torch.cat([data.image[rows].permute(0, 3, 1, 2), data.mask[rows][:, None]], 1).float()
    box, scale = data.box[rows], data.scale[rows]
    outside, box = truncated(tiles[:, 3:], box, 0.14)
    tiles = torch.cat([tiles, outside], 1)
    size = torch.cat([box[:, 2:] - box[:, :2]] * 2, 1)
    spread = torch.tensor([0.0, 0.05, 0.1], device=device)[torch.randint(3, (n, 1), device=device)]
    moved = box + (torch.rand(n, 4, device=device) * 2 - 1) * spread * size
    # A neighbor of the truth's box by a pixel is no error of the prompt: whole pixels of the image.
    flip = torch.where(torch.rand(n, device=device) < 0.5, -1.0, 1.0)
    grid, area = crop_grid(moved, scale, 2 * SIDE, flip)
    crops = sampled(tiles, grid)
    image, mask, outside = crops[:, :3], (crops[:, 3:4] / 255).clamp(0, 1), crops[:, 4:] > 0.5
    image = with_background(image, mask, 0.25)
    image, mask = with_occluder(image, mask, 0.12)
    image = colored(image)
    groups = []
    for part in image.chunk(8):
        draw = torch.rand(4)
        if draw[0] < 0.5:
            low = int(torch.exp(torch.empty(1).uniform_(np.log(14), np.log(SIDE))))
            part = functional.interpolate(part, size=(low, low), mode="area")
            if draw[3] < 0.5:
                part = part + 5 * torch.rand(1).item() * torch.randn_like(part)
            part = functional.interpolate(part, size=(SIDE, SIDE), mode="bilinear", align_corners=False)
        if draw[1] < 0.25:
            part = blurred(part, float(torch.empty(1).uniform_(0.4, 2.2)), int(torch.randint(3, (1,))))
        if draw[2] < 0.5:
            part = part + float(torch.empty(1).uniform_(0, 12)) ** 1.0 * torch.randn_like(part)
        groups.append(part)
    image = torch.cat(groups).clamp(0, 255)
    channel = box_channel(moved, area, flip)
    # Some crops reach beyond the border of their image: only what lies outside of the box.
    cells = torch.arange(SIDE, device=device)
    for axis in (2, 3):
        for at_end in (False, True):
            use = torch.rand(n, device=device) < 0.04
            inside = channel.amax((1, 5 - axis))
            first = inside.gt(0.5).float().argmax(1)
            edge = first if not at_end else SIDE - first
            beyond = (cells[None] >= edge[:, None]) if at_end else (cells[None] < edge[:, None])
            beyond = (beyond & use[:, None]).view(n, 1, *((SIDE, 1) if axis == 2 else (1, SIDE)))
            image = torch.where(beyond, torch.full_like(image, 114), image)
            channel = torch.where(beyond, torch.full_like(channel, -1), channel)
            mask = torch.where(beyond, torch.zeros_like(mask), mask)
    image = torch.where(outside, torch.full_like(image, 114), image)
    channel = torch.where(outside, torch.full_like(channel, -1), channel)
    mask = torch.where(outside, torch.zeros_like(mask), mask)
    return torch.cat([(image - 128) / 64, channel], 1), mask


def losses(logits: torch.Tensor, quality: torch.Tensor, target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The loss and the mean IoU. Pixels near the outline count more, those at its lower half most."""
    logits = logits.float()
    near = (functional.avg_pool2d(target, 9, 1, 4, count_include_pad=False) - target).abs()
    below = torch.linspace(0, 1, target.shape[2], device=target.device)[None, None, :, None]
    weight = 1 + near * (6 + 6 * (below > 0.5))
    entropy = functional.binary_cross_entropy_with_logits(logits, target, weight=weight)
    inside = torch.sigmoid(logits)
    shared, total = (inside * target).sum((1, 2, 3)), (inside + target).sum((1, 2, 3))
    dice = 1 - (2 * shared + 20) / (total + 20)
    with torch.no_grad():
        found, truth = logits > 0, target > 0.5
        overlap = (found & truth).sum((1, 2, 3)) / (found | truth).sum((1, 2, 3)).clamp(min=1)
    judged = functional.binary_cross_entropy_with_logits(quality.float()[:, 0], overlap)
    return entropy + dice.mean() + 0.1 * judged, overlap[truth.any(3).any(2)[:, 0]].mean()


def main() -> None:
    """Reads the arguments and trains."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tiles", type=Path, nargs="+", required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=400)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument("--refresh", type=float, default=60, help="seconds between looks for new tiles")
    parser.add_argument("--start", type=Path, help="checkpoint whose weights training starts from")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(arguments.seed)
    np.random.seed(arguments.seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    data = Data(arguments.tiles, device)
    data.refresh()
    network = BoxMaskNet().to(device).to(memory_format=torch.channels_last)
    if arguments.start:
        network.load_state_dict(torch.load(arguments.start, map_location=device)["average"])
    average = copy.deepcopy(network)
    decayed = [p for p in network.parameters() if p.dim() > 1]
    others = [p for p in network.parameters() if p.dim() <= 1]
    groups = [{"params": decayed, "weight_decay": 0.02}, {"params": others, "weight_decay": 0.0}]
    optimizer = torch.optim.AdamW(groups, lr=arguments.rate)
    step, spent = 0, 0.0
    checkpoint = arguments.output / "checkpoint.pt"
    if checkpoint.is_file():
        state = torch.load(checkpoint, map_location=device)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        step, spent = state["step"], state["spent"]
        torch.manual_seed(arguments.seed + step)
    log = (arguments.output / "log.txt").open("a")
    before, last, running = time.monotonic() - spent, time.monotonic(), []
    saved = last

    def save() -> None:
        state = {"network": network.state_dict(), "average": average.state_dict(), "optimizer": optimizer.state_dict()}
        partial = checkpoint.with_suffix(".partial")
        torch.save({**state, "step": step, "spent": time.monotonic() - before}, partial)
        partial.replace(checkpoint)

    while time.monotonic() - before < arguments.seconds and step < MOST_STEPS:
        done = (time.monotonic() - before) / arguments.seconds
        rate = float(arguments.rate * min(1.0, step / 300) * (0.5 * (1 + np.cos(np.pi * done)) + 0.002))
        for group in optimizer.param_groups:
            group["lr"] = rate
        with torch.no_grad():
            inputs, target = batch(data, arguments.batch)
        with torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda"):
            logits, quality = network(inputs.contiguous(memory_format=torch.channels_last))
        loss, overlap = losses(logits, quality, target)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimizer.step()
        step += 1
        with torch.no_grad():
            keep = min(0.999, 1 - 10 / (10 + step))
            for mean, value in zip(average.state_dict().values(), network.state_dict().values()):
                if mean.dtype.is_floating_point:
                    mean.lerp_(value.to(mean.dtype), 1 - keep)
                else:
                    mean.copy_(value)
        running.append((loss.detach(), overlap.detach()))
        if time.monotonic() - last > 8:
            last = time.monotonic()
            means = torch.stack([torch.stack(r) for r in running]).nanmean(0).tolist()
            running = []
            line = {"step": step, "s": round(last - before), "rate": round(rate, 6), "loss": means[0], "iou": means[1]}
            print(json.dumps(line), flush=True)
            log.write(json.dumps(line) + "\n")
            log.flush()
            if last - saved > arguments.refresh:
                saved = last
                save()
                data.refresh()
    save()
    export(average, str(arguments.output / "box_masks.onnx"))
    print("steps:", step, flush=True)


if __name__ == "__main__":
    main()
