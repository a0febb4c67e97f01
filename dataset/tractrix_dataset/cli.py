"""Command line arguments shared by the scripts."""

from __future__ import annotations

import argparse
from pathlib import Path

from .render import RenderOptions
from .scenarios import NAMES
from .vehicles.heavy import FLEET

MIB = 1024 * 1024


def size(text: str) -> tuple[int, int]:
    """``960x540`` as two numbers."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, such as 960x540") from error
    if width < 64 or height < 64 or width % 2 or height % 2:
        raise argparse.ArgumentTypeError(f"{text}: both sides must be even and at least 64 pixels")
    return width, height


def add_render_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of every command that renders."""
    parser.add_argument("--resolution", type=size, default=(960, 540), help="WIDTHxHEIGHT, default 960x540")
    parser.add_argument("--samples", type=int, default=4, help="samples per pixel before denoising, default 4")
    parser.add_argument("--threads", type=int, default=0, help="render threads, default all")
    parser.add_argument("--frames", type=int, default=60, help="number of frames, default 60")
    parser.add_argument("--seed", type=int, default=0, help="another seed makes another variant")
    parser.add_argument("--max-mib", type=float, default=4.0, help="largest size of one sequence in MiB, default 4")
    parser.add_argument("--images", action="store_true", help="also keep the frames as JPEG files")


def render_options(arguments: argparse.Namespace) -> RenderOptions:
    """The render options of parsed arguments."""
    return RenderOptions(*arguments.resolution, arguments.samples, arguments.threads)


def add_names(parser: argparse.ArgumentParser) -> None:
    """Which sequence, and where it goes."""
    parser.add_argument("--trajectory", choices=sorted(NAMES), required=True)
    parser.add_argument("--vehicle", choices=sorted(FLEET), required=True)
    parser.add_argument("--output", type=Path, required=True, help="folder of the sequence")
