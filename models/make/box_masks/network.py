"""The box mask network: a plain convolutional U-Net of about 0.9 million parameters.

Input: RGB crop and box channel, [n, 4, 128, 128]; RGB is (v - 128) / 64; the box channel is 1 in the box, 0 around
it, -1 beyond the border of the image. Output: logits [n, 1, 128, 128] and the expected IoU [n, 1].
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

WIDTHS = (16, 32, 64, 128)


class Unit(nn.Module):
    """A 3x3 convolution with batch norm and ReLU, with a residual path where the shapes allow."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.norm = nn.BatchNorm2d(outputs)
        self.has_residual = stride == 1 and inputs == outputs

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Runs the unit."""
        y = self.norm(self.convolution(x))
        return functional.relu(x + y if self.has_residual else y)


class Up(nn.Module):
    """Doubles the resolution, adds the encoder's features of that resolution."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.mix = nn.Conv2d(inputs, outputs, 1)
        self.unit = Unit(outputs, outputs)

    def forward(self, x: torch.Tensor, skip: torch.Tensor) -> torch.Tensor:
        """Runs the block."""
        return self.unit(functional.interpolate(self.mix(x), scale_factor=2.0, mode="nearest") + skip)


class BoxMaskNet(nn.Module):
    """Encoder at strides 2 to 16, context by a global mean, decoder back to stride 2, subpixel logits."""

    def __init__(self, widths: tuple[int, ...] = WIDTHS, depths: tuple[int, ...] = (1, 1, 2, 3)) -> None:
        super().__init__()
        stages, inputs = [], 4
        for width, depth in zip(widths, depths):
            stages.append(nn.Sequential(Unit(inputs, width, 2), *[Unit(width, width) for _ in range(depth)]))
            inputs = width
        self.stages = nn.ModuleList(stages)
        self.context = nn.Linear(inputs, inputs)
        self.last = Unit(inputs, inputs)
        self.ups = nn.ModuleList([Up(deep, shallow) for deep, shallow in zip(widths[:0:-1], widths[-2::-1])])
        self.head = nn.Conv2d(widths[0], 4, 3, 1, 1)
        self.quality = nn.Sequential(nn.Linear(inputs + widths[1], 32), nn.ReLU(), nn.Linear(32, 1))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits of the mask and of the quality."""
        features = []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        x = self.last(x + self.context(x.mean((2, 3)))[:, :, None, None])
        summary = [x.mean((2, 3))]
        for up, skip in zip(self.ups, features[-2::-1]):
            x = up(x, skip)
            if x.shape[1] == WIDTHS[1] and len(summary) == 1:
                summary.append(x.mean((2, 3)))
        return functional.pixel_shuffle(self.head(x), 2), self.quality(torch.cat(summary, 1))


class Exported(nn.Module):
    """As the program runs it: the quality as a number from 0 to 1."""

    def __init__(self, network: BoxMaskNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, crop: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Runs the network."""
        logits, quality = self.network(crop)
        return logits, torch.sigmoid(quality)


def export(network: BoxMaskNet, path: str) -> None:
    """Writes an ONNX file; batch norm is folded into the convolutions."""
    module = Exported(network).eval().float().cpu()
    torch.onnx.export(
        module,
        (torch.zeros(1, 4, 128, 128),),
        path,
        input_names=["crop"],
        output_names=["logits", "quality"],
        dynamic_axes={"crop": {0: "n"}, "logits": {0: "n"}, "quality": {0: "n"}},
        opset_version=17,
        dynamo=False,
    )
