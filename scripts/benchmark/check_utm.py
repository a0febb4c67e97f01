"""Open a model in UTM with COLMAP's own reader and compare its cameras with the GPS positions of the photographs.

    tractrix sfm PHOTOS --output OUT
    tractrix convert OUT utm --frame utm
    check_utm.py utm PHOTOS [--most METERS]

Needs `pip install numpy pillow pycolmap pyproj`. Prints the differences east, north and up; exit code 1 if a camera is
missing, the EPSG code differs from the zone of the photographs, or the root mean square of the horizontal differences
exceeds METERS.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import pycolmap
from PIL import ExifTags, Image
from pyproj import Transformer


def position(path: Path) -> tuple[float, float, float] | None:
    """Longitude, latitude and altitude in the EXIF data of a photograph."""
    with Image.open(path) as image:
        gps = image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
    if ExifTags.GPS.GPSLongitude not in gps:
        return None

    def degrees(value: ExifTags.GPS, reference: ExifTags.GPS) -> float:
        parts = [float(part) for part in gps[value]]
        sign = -1.0 if gps[reference] in ("S", "W") else 1.0
        return sign * (parts[0] + parts[1] / 60.0 + parts[2] / 3600.0)

    longitude = degrees(ExifTags.GPS.GPSLongitude, ExifTags.GPS.GPSLongitudeRef)
    latitude = degrees(ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLatitudeRef)
    return longitude, latitude, float(gps.get(ExifTags.GPS.GPSAltitude, 0.0))


def zone(longitude: float, latitude: float) -> int:
    """EPSG code of the UTM zone, without the exceptions of Norway."""
    return (32600 if latitude >= 0 else 32700) + int((longitude + 180.0) // 6.0) + 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--most", type=float, default=5.0, metavar="METERS")
    args = parser.parse_args()
    model = pycolmap.Reconstruction(str(args.model))
    epsg = json.loads((args.model / "frame.json").read_text(encoding="utf-8"))["epsg"]
    grid = Transformer.from_crs(4326, epsg, always_xy=True)
    differences = []
    for image in model.images.values():
        found = position(args.photographs / image.name)
        if found is None:
            continue
        if zone(found[0], found[1]) != epsg:
            print(f"{image.name}: in zone {zone(found[0], found[1])}, the model in {epsg}")
            return 1
        east, north = grid.transform(found[0], found[1])
        differences.append(image.projection_center() - np.array([east, north, found[2]]))
    if not differences:
        print("no photograph has a position")
        return 1
    stacked = np.array(differences)
    rms = np.sqrt((stacked**2).mean(axis=0))
    horizontal = float(np.hypot(rms[0], rms[1]))
    print(f"pycolmap {pycolmap.__version__}: {model.num_images()} images, {model.num_points3D()} points, EPSG:{epsg}")
    print(f"{len(differences)} positions: RMS east {rms[0]:.2f} m, north {rms[1]:.2f} m, up {rms[2]:.2f} m")
    print(f"horizontal {horizontal:.2f} m, largest {np.abs(stacked).max():.2f} m")
    return 0 if horizontal <= args.most else 1


if __name__ == "__main__":
    sys.exit(main())
