"""Open what `tractrix export` wrote with programs that are not ours.

    check_exports.py OUT/export

Prints one line per file: the program, and what it read. A program that is not installed is named and left out. Exit
code 1 if a program refuses a file, or reads other numbers than stand in the tables.
"""

import argparse
import csv
import importlib.util
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    """Rows of one of the tables, which every other file is held against."""
    with (folder / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def expect(holds: bool, problem: str) -> None:
    """Raise where a file says something else than the tables."""
    if not holds:
        raise ValueError(problem)


def vector(folder: Path, name: str, features: int) -> str:
    """Layers of a map by GDAL."""
    import pyogrio

    path = folder / name
    layers = [str(layer) for layer, _ in pyogrio.list_layers(path)]
    found = {layer: pyogrio.read_info(path, layer=layer, force_feature_count=True)["features"] for layer in layers}
    largest = max(layers, key=lambda layer: found[layer])
    expect(found[largest] == features, f"{found[largest]} features where the tables have {features}")
    bounds = pyogrio.read_info(path, layer=largest, force_total_bounds=True)["total_bounds"]
    bounds = [round(float(value), 6) for value in bounds]
    return f"GDAL {pyogrio.__gdal_version__}: {found}, bounds {bounds}"


def geojson_ways(folder: Path) -> str:
    """Ways of vehicles and camera."""
    return vector(folder, "trajectories.geojson", len(rows(folder, "vehicles.csv")) + 1)


def geojson_places(folder: Path) -> str:
    """Places frame by frame."""
    return vector(folder, "positions.geojson", len(rows(folder, "trajectories.csv")) + len(rows(folder, "camera.csv")))


def kml(folder: Path) -> str:
    """Tracks with times."""
    return vector(folder, "trajectories.kml", len(rows(folder, "vehicles.csv")) + 1)


def gpx(folder: Path) -> str:
    """The camera's track."""
    return vector(folder, "camera.gpx", len(rows(folder, "camera.csv")))


def poses(folder: Path) -> str:
    """Poses by evo: as many as the tables have, at the same places."""
    from evo.tools import file_interface

    said = []
    camera = rows(folder, "camera.csv")
    tum = file_interface.read_tum_trajectory_file(folder / "tum" / "camera.txt")
    kitti = file_interface.read_kitti_poses_file(folder / "kitti" / "camera.txt")
    expect(len(camera) == tum.num_poses == kitti.num_poses, "the camera has other frames than in its table")
    columns = ["x_m", "y_m", "z_m"] if camera[0]["x_m"] else ["x_units", "y_units", "z_units"]
    for index, row in enumerate(camera):
        for axis, column in enumerate(columns):
            expected = float(row[column])
            for found in (tum.positions_xyz[index][axis], kitti.positions_xyz[index][axis]):
                expect(abs(found - expected) < 1e-4 + 1e-9 * abs(expected), f"camera, row {index}: {found} {expected}")
    said.append(f"camera {tum.num_poses} poses, {tum.path_length:.3f} long")
    for path in sorted((folder / "tum").glob("vehicle-*.txt")):
        way = file_interface.read_tum_trajectory_file(path)
        check = way.check()
        expect(check[0], f"{path.name}: {check[1]}")
        said.append(f"{path.stem} {way.num_poses}")
    return "evo: " + ", ".join(said)


def glb(folder: Path) -> str:
    """The scene by trimesh."""
    import trimesh

    scene = trimesh.load(folder / "scene.glb")
    points = sum(len(geometry.vertices) for geometry in scene.geometry.values())
    expect(points > 0, "no points")
    return f"trimesh {trimesh.__version__}: {len(scene.geometry)} geometries, {points} vertices"


def blender(folder: Path) -> str:
    """The scene by Blender, and where its camera is in its last frame."""
    if importlib.util.find_spec("bpy") is None:
        raise ImportError("no module named bpy")
    program = (
        "import bpy, sys, json\n"
        "bpy.ops.wm.read_factory_settings(use_empty=True)\n"
        "bpy.context.scene.render.fps = 1000\n"
        f"bpy.ops.import_scene.gltf(filepath={str(folder / 'scene.glb')!r})\n"
        "names = [o.name for o in bpy.data.objects]\n"
        "camera = next(o for o in bpy.data.objects if o.type == 'CAMERA')\n"
        "end = int(max(a.frame_range[1] for a in bpy.data.actions))\n"
        "bpy.context.scene.frame_set(end)\n"
        "place = list((camera.matrix_world.translation))\n"
        "print('FOUND', json.dumps([bpy.app.version_string, names, end, place]))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("FOUND "))
    version, names, end, place = json.loads(line.removeprefix("FOUND "))
    last = rows(folder, "camera.csv")[-1]
    # Blender turns y up into z up again: the frame of metres.
    if last["x_m"]:
        expected = [float(last[column]) for column in ("x_m", "y_m", "z_m")]
        off = max(abs(a - b) for a, b in zip(place, expected, strict=True))
        expect(off < 1e-2, f"the camera ends at {place}, and should at {expected}")
    return f"Blender {version}: {len(names)} objects, {end} ms, camera ends at {[round(v, 3) for v in place]}"


def video(folder: Path) -> str:
    """The annotated video by FFmpeg's own program."""
    keys = "stream=codec_name,pix_fmt,width,height,nb_read_frames,color_space:format=duration"
    command = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", keys, "-of", "json"]
    done = subprocess.run([*command, folder / "annotated.mp4"], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    stream = found["streams"][0]
    expect(stream["pix_fmt"] == "yuv420p", f"pixels are {stream['pix_fmt']}")
    expect(int(stream["nb_read_frames"]) >= len(rows(folder, "camera.csv")), "frames are missing")
    return f"ffprobe: {stream}, {found['format']['duration']} s"


def colmap(folder: Path) -> str:
    """The workspace by pycolmap: model, pictures and masks belong together, and images are undistorted."""
    import tempfile

    import numpy
    import pycolmap
    from PIL import Image

    pycolmap.logging.minloglevel = 2
    workspace = folder / "colmap"
    model = pycolmap.Reconstruction(workspace / "sparse" / "0")
    masked = []
    for image in model.images.values():
        with Image.open(workspace / "images" / image.name) as picture:
            camera = model.cameras[image.camera_id]
            expect(picture.size == (camera.width, camera.height), f"{image.name}: {picture.size}")
        with Image.open(workspace / "masks" / f"{image.name}.png") as mask:
            expect(mask.size == (camera.width, camera.height), f"mask of {image.name}: {mask.size}")
            masked.append(float(numpy.mean(numpy.asarray(mask) == 0)))
    with tempfile.TemporaryDirectory() as dense:
        pycolmap.undistort_images(dense, workspace / "sparse" / "0", workspace / "images")
        count = len(list((Path(dense) / "images").iterdir()))
    expect(count == model.num_reg_images(), f"{count} undistorted images")
    share = 100 * sum(masked) / max(len(masked), 1)
    size = f"{model.num_reg_images()} images, {model.num_points3D()} points"
    return f"pycolmap {pycolmap.__version__}: {size}, {share:.1f} % masked, undistorted"


def cot(folder: Path) -> str:
    """Events as TAK's own protocol has them, against the tables of the same export."""
    import xml.etree.ElementTree

    import takproto

    wanted = {(row["vehicle"], row["date"]): row for row in rows(folder, "trajectories.csv")}
    events = xml.etree.ElementTree.parse(folder / "cot-events.xml").getroot()
    for event in events:
        text = xml.etree.ElementTree.tostring(event, encoding="unicode")
        found = takproto.parse_proto(takproto.xml2proto(text, takproto.TAKProtoVer.STREAM)).cotEvent
        row = wanted.get((found.uid.rsplit(".", 1)[1], event.get("time", "")))
        if row is None:
            continue  # of a ground track
        for value, column in ((found.lat, "latitude"), (found.lon, "longitude"), (found.ce, "place_std_m")):
            expect(abs(value - float(row[column])) < 1e-4, f"{column} {value}, {row[column]} in the table")
        if row["speed_m_s"]:
            speed = found.detail.track.speed
            expect(abs(speed - abs(float(row["speed_m_s"]))) < 1e-3, f"speed {speed}, {row['speed_m_s']} in the table")
    return f"takproto: {len(events)} events"


CHECKS: dict[str, tuple[str, Callable[[Path], str]]] = {
    "trajectories.geojson": ("trajectories.geojson", geojson_ways),
    "positions.geojson": ("positions.geojson", geojson_places),
    "trajectories.kml": ("trajectories.kml", kml),
    "camera.gpx": ("camera.gpx", gpx),
    "cot": ("cot-events.xml", cot),
    "tum, kitti": ("tum", poses),
    "scene.glb": ("scene.glb", glb),
    "scene.glb in Blender": ("scene.glb", blender),
    "annotated.mp4": ("annotated.mp4", video),
    "colmap": ("colmap", colmap),
}


def main() -> int:
    """Check every file that is there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder that `tractrix export` wrote, with its tables")
    folder = parser.parse_args().folder
    failed = False
    for name, (path, check) in CHECKS.items():
        if not (folder / path).exists():
            print(f"{name}: not there")
            continue
        try:
            print(f"{name}: {check(folder)}")
        except (ImportError, FileNotFoundError) as missing:
            absent = isinstance(missing, ImportError) or shutil.which(str(missing.filename)) is None
            print(f"{name}: left out, {missing}" if absent else f"{name}: FAILED, {missing}")
            failed |= not absent
        except (ValueError, RuntimeError, KeyError, subprocess.CalledProcessError) as error:
            failed = True
            said = error.stderr if isinstance(error, subprocess.CalledProcessError) else error
            print(f"{name}: FAILED, {said}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
