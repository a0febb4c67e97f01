#!/usr/bin/env python3
"""Writes photographs of free licenses at a smaller size: objects of any kind for the teacher, grounds for synthesis.

python photos.py --repositories DIR --output DIR
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
from collect import SOURCES, images_of

LONGER, QUALITY = 1280, 82
STILLS = {
    "OpenDroneMap/odm_data_caliterra": 5,
    "OpenDroneMap/odm_data_lewis": 6,
    "merkato/odm_boruszyn_kap": 3,
    "obss/sahi": 1,
    "dusty-nv/jetson-inference": 8,
}


def main() -> None:
    """Reads the arguments and writes every so many images of each source."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repositories", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    for s, source in enumerate(SOURCES):
        step = STILLS.get(source.repository)
        if step is None:
            continue
        for number, (_, image) in enumerate(images_of(source, arguments.repositories)):
            scale = LONGER / max(image.shape[:2])
            if number % step or scale > 1.6:
                continue
            small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            cv2.imwrite(
                str(arguments.output / f"{s:02d}_{number:04d}.webp"), small, [cv2.IMWRITE_WEBP_QUALITY, QUALITY]
            )


if __name__ == "__main__":
    main()
