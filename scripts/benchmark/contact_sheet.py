"""Frames of a video with the masks of a run drawn over them, as one picture to look at."""

import subprocess
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from run_output import RunOutput, box_of

COLORS = [(230, 60, 50), (60, 170, 240), (90, 200, 70), (250, 180, 30), (190, 90, 230), (40, 210, 190), (240, 120, 170)]
NUM_FRAMES = 8
COLUMNS = 2
WIDTH = 720
FONT_PX = 22
# Share of the colour in a mask's pixels.
TINT = 0.45


def decoded(video: Path, frames: list[int], size: tuple[int, int]) -> list[np.ndarray]:
    """The given frames of a video (ascending), height × width × 3, with the program ffmpeg."""
    wanted = "+".join(f"eq(n\\,{frame})" for frame in frames)
    scaled = f"select={wanted},scale={size[0]}:{size[1]}"
    command = ["ffmpeg", "-loglevel", "error", "-i", video, "-vf", scaled, "-vsync", "0"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = np.frombuffer(subprocess.run(command, check=True, capture_output=True).stdout, dtype=np.uint8)
    return list(raw[: len(raw) // (size[0] * size[1] * 3) * size[0] * size[1] * 3].reshape(-1, size[1], size[0], 3))


def overlaid(picture: np.ndarray, output: RunOutput, frame: int) -> Image.Image:
    """A frame with every track's mask in its colour; a frame round those that have a trajectory."""
    pixels, marks = picture.astype(float), []
    for track in output.ids:
        mask = output.mask(track, f"{frame:06d}.jpg")
        box = None if mask is None else box_of(mask)
        if box:
            color = COLORS[track % len(COLORS)]
            pixels[mask] = (1 - TINT) * pixels[mask] + TINT * np.array(color)
            marks.append((track, box, color))
    image = Image.fromarray(pixels.astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for track, box, color in marks:
        if track in output.objects:
            draw.rectangle((box[0] - 2, box[1] - 2, box[2] + 2, box[3] + 2), outline=color, width=2)
        words = f"{track} {output.said(track)['class'] or ''}"
        draw.text((box[0], max(0, box[1] - FONT_PX - 4)), words, fill=color, font_size=FONT_PX)
    draw.text((8, 6), f"frame {frame}", fill=(255, 255, 255), font_size=FONT_PX)
    return image


def write_sheet(video: Path, output: RunOutput, path: Path) -> None:
    """Eight frames, evenly spread over the run, as a PNG."""
    frames = sorted({int(f) for f in np.linspace(0, max(0, output.num_frames - 1), NUM_FRAMES)})
    pictures = [overlaid(p, output, f) for f, p in zip(frames, decoded(video, frames, output.size))]
    if not pictures:
        return
    height = round(WIDTH * pictures[0].height / pictures[0].width)
    sheet = Image.new("RGB", (COLUMNS * WIDTH, -(-len(pictures) // COLUMNS) * height))
    for k, picture in enumerate(pictures):
        sheet.paste(picture.resize((WIDTH, height)), (k % COLUMNS * WIDTH, k // COLUMNS * height))
    sheet.save(path)
