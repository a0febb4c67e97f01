"""Results of tractrix in Python.

`load` reads an output folder of `tractrix run`; the program itself is not needed.

    import tractrix

    results = tractrix.load("out")
    for vehicle in results.vehicles.values():
        print(vehicle.id, vehicle.class_name, vehicle.verdict.state, vehicle.speed_kmh.mean())

Frames, axes and units: docs/conventions.md; files: docs/formats.md.
"""

from .errors import DamagedError, MissingError, OutputError, VersionError
from .geometry import Sim3
from .masks import Masks, read_mask
from .plot import plot_map, plot_paths, plot_speeds
from .points import PointCloud, read_ply
from .reconstruction import Camera, Image, Points3D, Reconstruction, read_reconstruction
from .results import Cameras, Metric, Results, load
from .vehicles import (
    Dimensions,
    Estimate,
    GroundTrack,
    GroundVerdict,
    Reason,
    Scale,
    Track,
    Travel,
    Vehicle,
    Verdict,
)

__all__ = [
    "Camera",
    "Cameras",
    "DamagedError",
    "Dimensions",
    "Estimate",
    "GroundTrack",
    "GroundVerdict",
    "Image",
    "Masks",
    "Metric",
    "MissingError",
    "OutputError",
    "PointCloud",
    "Points3D",
    "Reason",
    "Reconstruction",
    "Results",
    "Scale",
    "Sim3",
    "Track",
    "Travel",
    "Vehicle",
    "Verdict",
    "VersionError",
    "load",
    "plot_map",
    "plot_paths",
    "plot_speeds",
    "read_mask",
    "read_ply",
    "read_reconstruction",
]
__version__ = "0.1.0"
