#!/usr/bin/env python3
"""Measures `tractrix live` on a clip that is piped into it at its own rate.

    scripts/live/measure.py VIDEO OUT [--truth SEQUENCE] [--batch OUT] [--seconds S] [--fixes STD]
        [-- FLAGS OF tractrix live]

Prints one JSON object: delay from a frame's time to the line of its provisional position, time to the first position
of each vehicle, dropped frames, load, memory, and with --truth the errors of provisional and final positions against a
rendered sequence (scene.json), with --batch those of an output folder of `tractrix run` by the same measure. --fixes
sends true camera positions, five a second, into a named pipe for --telemetry, with a constant error of STD meters on
each axis and noise of a fifth of it, and prints errors of georeferenced positions over their standard deviations. Needs
ffmpeg and numpy; the program is $TRACTRIX or target/release/tractrix.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
PROGRAM = os.environ.get("TRACTRIX", str(Path(__file__).parents[2] / "target/release/tractrix"))

NEAR_M = 5.0  # another vehicle is further away


def paced(video: Path, seconds: float | None, speed: float = 1.0) -> subprocess.Popen[bytes]:
    """The packets of a clip as MPEG-TS, each at its time, or faster or slower."""
    limit = ["-t", str(seconds)] if seconds else []
    form = ["-c", "copy", "-f", "mpegts", "-muxdelay", "0", "-muxpreload", "0", "-flush_packets", "1", "-"]
    command = ["ffmpeg", "-v", "error", "-readrate", str(speed), *limit, "-i", str(video), "-an", *form]
    return subprocess.Popen(command, stdout=subprocess.PIPE)


def rss_mib(pid: int) -> float:
    """Resident memory of a process."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    lines = [line.split() for line in status.splitlines() if line.startswith("VmRSS")]
    return float(lines[0][1]) / 1024 if lines else 0.0


def thread_cpu_s(pid: int) -> dict[str, float]:
    """Processor time of the threads of a process, by name."""
    spent: dict[str, float] = {}
    for stat in Path(f"/proc/{pid}/task").glob("*/stat"):
        try:
            name, rest = stat.read_text().split("(", 1)[1].rsplit(")", 1)
        except OSError:
            continue
        user, system = rest.split()[11:13]
        spent[name] = spent.get(name, 0.0) + (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    return spent


LATITUDE, LONGITUDE, HEIGHT_M = 47.3, 8.5, 420.0  # of the origin of a rendered sequence
# Meters per degree there, on the ellipsoid of WGS 84 (radii of curvature).
NORTH_M = math.radians(6335439.327 / (1 - 0.0066943799901 * math.sin(math.radians(LATITUDE)) ** 2) ** 1.5)
EAST_M = math.radians(6378137.0 / (1 - 0.0066943799901 * math.sin(math.radians(LATITUDE)) ** 2) ** 0.5) * math.cos(
    math.radians(LATITUDE)
)
RATE_HZ = 5.0


def geodetic(position: Array) -> tuple[float, float, float]:
    """Latitude, longitude, height of a position of a rendered sequence: x to the east, y to the north."""
    return LATITUDE + position[1] / NORTH_M, LONGITUDE + position[0] / EAST_M, HEIGHT_M + position[2]


class Fixes(threading.Thread):
    """Writes positions of the camera into a named pipe, each at its time."""

    def __init__(self, pipe: Path, truth: "Truth", std_m: float, speed: float) -> None:
        super().__init__(daemon=True)
        self.pipe, self.speed = pipe, speed
        noise = np.random.default_rng(1)
        bias = noise.normal(0, std_m, 3)
        times = np.arange(0, truth.times[-1], 1 / RATE_HZ)
        centers = np.array([camera[:3, 3] for camera in truth.cameras])
        at = np.stack([np.interp(times, truth.times, centers[:, axis]) for axis in range(3)], 1)
        self.rows = []
        for time_s, position in zip(times, at + bias + noise.normal(0, std_m / 5, at.shape), strict=True):
            stamp = datetime.fromtimestamp(1717243200 + time_s, UTC).isoformat(timespec="milliseconds")
            latitude, longitude, height = geodetic(position)
            place = f"{latitude:.8f},{longitude:.8f},{height:.3f}"
            text = f"{stamp.replace('+00:00', 'Z')},{place},{std_m:.2f},{std_m:.2f}\n"
            self.rows.append((time_s, text))
        os.mkfifo(pipe)

    def run(self) -> None:
        """Waits for the reader, then sends."""
        with self.pipe.open("w") as to:
            begin = time.monotonic()
            to.write("utc,latitude,longitude,altitude,hAcc,vAcc\n")
            for time_s, text in self.rows:
                time.sleep(max(0.0, begin + time_s / self.speed - time.monotonic()))
                to.write(text)
                to.flush()


class Live:
    """A run of `tractrix live` on a pipe."""

    def __init__(self, video: Path, out: Path, seconds: float | None, speed: float, flags: list[str]) -> None:
        source = paced(video, seconds, speed)
        self.speed = speed
        command = [PROGRAM, "live", "-", "--output", str(out), "--overwrite", "--no-final-run", *flags]
        self.program = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.begin: float | None = None
        self.memory: list[tuple[float, float]] = []
        self.threads: dict[str, float] = {}
        self.lines: list[tuple[float, dict[str, Any]]] = []
        threads = [threading.Thread(target=self.relay, args=(source,)), threading.Thread(target=self.watch)]
        for thread in threads:
            thread.start()
        assert self.program.stdout
        for text in self.program.stdout:
            self.lines.append((time.monotonic(), json.loads(text)))
        _, status, usage = os.wait4(self.program.pid, 0)
        self.program.returncode = self.code = os.waitstatus_to_exitcode(status)
        self.cpu_s = usage.ru_utime + usage.ru_stime
        for thread in threads:
            thread.join()

    def relay(self, source: subprocess.Popen[bytes]) -> None:
        """Passes the bytes on and notes when they began."""
        assert source.stdout and self.program.stdin
        try:
            while chunk := os.read(source.stdout.fileno(), 1 << 16):
                self.begin = self.begin or time.monotonic()
                self.program.stdin.write(chunk)
                self.program.stdin.flush()
            self.program.stdin.close()
        except BrokenPipeError:
            source.kill()

    def watch(self) -> None:
        """Samples memory and processor time once a second."""
        while self.program.returncode is None:
            # Threads may have ended before the last sample.
            for name, spent in thread_cpu_s(self.program.pid).items():
                self.threads[name] = max(spent, self.threads.get(name, 0.0))
            self.memory.append((time.monotonic() - (self.begin or time.monotonic()), rss_mib(self.program.pid)))
            time.sleep(1)

    def of(self, kind: str, state: str | None = None) -> Iterator[tuple[float, dict[str, Any]]]:
        """Lines of a kind, with the times at which they came."""
        return ((at, line) for at, line in self.lines if line["kind"] == kind and state in (None, line.get("state")))

    def timing(self) -> dict[str, Any]:
        """Delays, first positions, drops and memory."""
        begin = self.begin or 0.0
        delays = [
            at - begin - line["t"] / self.speed for at, line in self.of("vehicle", "provisional") if line["position"]
        ]
        first_seen: dict[int, float] = {}
        first_placed: dict[int, float] = {}
        for at, line in self.of("vehicle", "provisional"):
            first_seen.setdefault(line["id"], line["t"])
            if line["position"]:
                first_placed.setdefault(line["id"], at - begin)
        waits = {number: round(first_placed[number] - first_seen[number], 2) for number in first_placed}
        late = [mib for at, mib in self.memory if at > 0.5 * self.memory[-1][0]]
        end = next((line for _, line in self.of("end")), {})
        maps = [line for _, line in self.of("map")]
        return {
            "exit": self.code,
            "cpu_s": round(self.cpu_s, 1),
            # The main thread (tractrix) has points and positions; threads of networks and OpenCV have its name, too.
            "cpu_ms_per_frame": {
                name: round(1000 * spent / max(1, end.get("frames", 1)), 1)
                for name, spent in sorted(self.threads.items(), key=lambda item: -item[1])[:6]
            },
            "delay_s": quantiles(delays),
            "vehicles": len(first_seen),
            "first_position_s": round(min(first_placed.values()), 2) if first_placed else None,
            "from_first_line_s": waits,
            "load": [[line["t"], line["level"], line["reason"]] for _, line in self.of("load")],
            "maps": len(maps),
            "restarts": sum(not line["is_continued"] for line in maps),
            "map_s": quantiles([line["seconds"] for line in maps]),
            "last_map": {
                key: maps[-1][key] for key in ("keyframes", "points", "scale", "scale_std", "drift_std", "focal_px")
            }
            if maps
            else None,
            "rss_mib": {"max": round(max((mib for _, mib in self.memory), default=0)), "second_half": spread(late)},
            "end": {key: value for key, value in end.items() if key != "kind"},
        }


def quantiles(values: list[float]) -> dict[str, float] | None:
    """Median, 95 % and maximum."""
    if not values:
        return None
    return {name: round(float(np.quantile(values, q)), 3) for name, q in (("p50", 0.5), ("p95", 0.95), ("max", 1.0))}


def spread(values: list[float]) -> list[float]:
    """Least and greatest value."""
    return [round(min(values)), round(max(values))] if values else []


def rotation(wxyz: list[float]) -> Array:
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def umeyama(source: Array, target: Array) -> tuple[float, Array, Array]:
    """The similarity target = s R source + t."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, d, vt = np.linalg.svd(b.T @ a / len(a))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    turn = u @ sign @ vt
    scale = float(np.trace(np.diag(d) @ sign) / (a**2).sum(1).mean())
    return scale, turn, target.mean(0) - scale * turn @ source.mean(0)


class Truth:
    """A rendered sequence."""

    def __init__(self, folder: Path) -> None:
        scene = json.loads((folder / "scene.json").read_text())
        self.cameras = [np.array(frame["T_world_camera"]) for frame in scene["frames"]]
        self.objects = [np.array(frame["T_world_object"]) for frame in scene["frames"]]
        self.times = [frame["time_s"] for frame in scene["frames"]]
        self.mesh = mesh_points(folder / "object_mesh.ply")
        path = np.diff([camera[:3, 3] for camera in self.cameras], axis=0)
        self.reach = max(1.0, float(np.linalg.norm(path, axis=1).sum()) / 4)

    def register(self, poses: dict[int, tuple[Array, Array]]) -> tuple[float, Array, Array]:
        """The similarity from estimated poses (center, axes of the camera as columns) to the true ones.

        By centers, and by points below and ahead of them, since a straight path leaves the roll open.
        """
        frames = sorted(poses)
        true = [self.cameras[k] for k in frames]
        centers = np.array([poses[k][0] for k in frames])
        true_centers = np.array([camera[:3, 3] for camera in true])
        length = np.linalg.norm(np.diff(centers, axis=0), axis=1).sum()
        ratio = float(np.linalg.norm(np.diff(true_centers, axis=0), axis=1).sum() / length)
        source = [centers] + [
            centers + self.reach / ratio * np.array([poses[k][1][:, a] for k in frames]) for a in (1, 2)
        ]
        target = [true_centers] + [true_centers + self.reach * np.array([c[:3, a] for c in true]) for a in (1, 2)]
        scale, turn, shift = umeyama(np.vstack(source), np.vstack(target))
        return scale, turn, shift

    def errors(
        self,
        poses: dict[int, tuple[Array, Array]],
        positions: dict[int, Array],
        covariances: dict[int, list[float]] | None = None,
        is_on_ground: bool = False,
    ) -> dict[str, Any] | None:
        """Errors of positions in a frame of their own, and how many are within the stated standard deviations."""
        if len(poses) < 5 or not positions:
            return None
        scale, turn, shift = self.register(poses)
        places, deviations = [], []
        middle = 0.5 * (self.mesh.max(0) + self.mesh.min(0))
        if is_on_ground:
            middle[2] = self.mesh[:, 2].min()
        for k, position in positions.items():
            world = scale * turn @ position + shift
            body = np.linalg.inv(self.objects[k])
            local = body[:3, :3] @ world + body[:3, 3]
            places.append(local[:3])
            if covariances:
                off_m = turn.T @ (world - self.objects[k][:3, :3] @ middle - self.objects[k][:3, 3])
                xx, xy, xz, yy, yz, zz = covariances[k]
                covariance = scale**2 * np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
                sight = position - poses[k][0]
                deviations.append(abs(sight @ off_m) / math.sqrt(sight @ covariance @ sight))
        off = np.array(places) - middle
        spread = np.linalg.norm(off - off.mean(0), axis=1)
        return {
            "frames": len(positions),
            "scale": round(scale, 4),
            # From the middle of the vehicle, of positions on the ground from the point below it; and about their mean.
            "offset_m": [round(float(x), 2) for x in off.mean(0)],
            "error_m": round(float(np.linalg.norm(off[:, :2], axis=1).mean()), 3),
            "spread_m": round(float(np.sqrt((spread**2).mean())), 3),
            "spread_max_m": round(float(spread.max()), 3),
            # Along the line of sight, within 1, 2, 3 standard deviations, per cent.
            "covered": [round(100 * float(np.mean(np.array(deviations) < n))) for n in (1, 2, 3)]
            if deviations
            else None,
        }


def of_geo(truth: Truth, live: Live) -> Any:
    """Errors of georeferenced positions, meters, and over the standard deviations that are stated."""
    middle = np.append(0.5 * (truth.mesh.max(0) + truth.mesh.min(0)), 1)
    result: dict[str, Any] = {}
    for kind in ("camera", "vehicle"):
        for state in ("provisional", "final"):
            rows = []
            for _, line in live.of(kind, state):
                geo = line["geo"]
                if geo is None:
                    continue
                frame = line["frame"]
                true = truth.cameras[frame][:3, 3] if kind == "camera" else (truth.objects[frame] @ middle)[:3]
                latitude, longitude, height = geodetic(true)
                east, north = (geo["longitude"] - longitude) * EAST_M, (geo["latitude"] - latitude) * NORTH_M
                horizontal = math.hypot(east, north)
                if kind == "camera" or horizontal < 4 * NEAR_M:
                    up = abs(geo["height"] - height)
                    rows.append((horizontal, geo["horizontal_std"], up, geo["vertical_std"]))
            if rows:
                table = np.array(rows)
                result[f"{kind}, {state}"] = {
                    "frames": len(rows),
                    "horizontal_m": quantiles(list(table[:, 0])),
                    "horizontal_std_m": quantiles(list(table[:, 1])),
                    "horizontal_over_std": quantiles(list(table[:, 0] / table[:, 1])),
                    "vertical_m": quantiles(list(table[:, 2])),
                    "vertical_over_std": quantiles(list(table[:, 2] / table[:, 3])),
                }
    result["scales"] = [[line["t"], line["scale"], line["scale_std"]] for _, line in live.of("map")]
    result["problems"] = sorted({line["telemetry_problem"] or "" for _, line in live.of("map")})
    return result


def mesh_points(path: Path) -> Array:
    """Vertices of an ASCII or binary PLY."""
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    words = [line.split() for line in head.decode().splitlines()]
    count = next(int(w[2]) for w in words if w[:2] == ["element", "vertex"])
    start = next(k for k, w in enumerate(words) if w[:2] == ["element", "vertex"])
    names = []
    for w in words[start + 1 :]:
        if w[0] != "property":
            break
        names.append((w[2], {"float": "<f4", "float32": "<f4", "double": "<f8", "uchar": "u1", "uint8": "u1"}[w[1]]))
    if b"format ascii" in head:
        rows = [line.split()[:3] for line in body.decode().splitlines()[:count]]
        return np.array(rows, float)
    table = np.frombuffer(body, np.dtype(names), count)
    return np.stack([table["x"], table["y"], table["z"]], 1).astype(float)


def nearest_track(
    truth: Truth,
    tracks: dict[int, dict[int, Array]],
    poses: dict[int, tuple[Array, Array]],
    covariances: dict[int, dict[int, list[float]]],
    is_on_ground: bool,
) -> Any:
    """The errors of the longest track that is near the true vehicle."""
    found = [truth.errors(poses, track, covariances.get(number), is_on_ground) for number, track in tracks.items()]
    near = [errors for errors in found if errors and errors["frames"] >= 5 and errors["error_m"] < NEAR_M]
    return max(near, key=lambda errors: errors["frames"], default=None)


def of_live(truth: Truth, live: Live, state: str, method: str | None) -> Any:
    """Errors of the positions of a state and method, or of all centers."""
    poses: dict[int, tuple[Array, Array]] = {}
    for _, line in live.of("camera", state):
        poses[line["frame"]] = np.array(line["position"]), rotation(line["rotation_wxyz"]).T
    tracks: dict[int, dict[int, Array]] = {}
    covariances: dict[int, dict[int, list[float]]] = {}
    for _, line in live.of("vehicle", state):
        is_wanted = line["method"] == method if method else line["method"] is not None
        if is_wanted and line["frame"] in poses:
            tracks.setdefault(line["id"], {})[line["frame"]] = np.array(line["position"])
            covariances.setdefault(line["id"], {})[line["frame"]] = line["covariance"]
    return nearest_track(truth, tracks, poses, covariances, method == "ground-contact")


def of_batch(truth: Truth, out: Path) -> Any:
    """Errors of an output folder of `tractrix run`, of its trajectories and of its ground tracks."""
    poses: dict[int, tuple[Array, Array]] = {}
    for line in (out / "background/images.txt").read_text().splitlines():
        words = line.split()
        if len(words) == 10 and words[-1].endswith(".jpg"):
            turn, shift = rotation([float(w) for w in words[1:5]]), np.array([float(w) for w in words[5:8]])
            poses[int(words[-1].split(".")[0])] = -turn.T @ shift, turn.T
    found = json.loads((out / "trajectories.json").read_text())
    result = {}
    for key in ("objects", "ground_tracks"):
        tracks = {
            entry["id"]: {pose["frame"]: np.array(pose["position"]) for pose in entry["frames"]}
            for entry in found.get(key, [])
        }
        result[key] = nearest_track(truth, tracks, poses, {}, key == "ground_tracks")
    return result


def main() -> None:
    """Runs, measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--batch", type=Path)
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--fixes", type=float, metavar="STD", help="standard deviation of the positions, meters")
    parser.add_argument("--speed", type=float, default=1.0, help="of the clip, for machines with other work")
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    args, flags = parser.parse_args(sys.argv[1:split]), sys.argv[split + 1 :]
    truth = Truth(args.truth) if args.truth else None
    with tempfile.TemporaryDirectory() as folder:
        if truth and args.fixes:
            pipe = Path(folder) / "fixes"
            Fixes(pipe, truth, args.fixes, args.speed).start()
            flags += ["--telemetry", str(pipe)]
        live = Live(args.video, args.out, args.seconds, args.speed, flags)
    result = live.timing()
    if truth:
        if args.fixes:
            result["georeferenced"] = of_geo(truth, live)
        for state in ("provisional", "final"):
            for method in ("ground-contact", "model", None):
                result[f"{state}, {method or 'all'}"] = of_live(truth, live, state, method)
        if args.batch:
            result["batch"] = of_batch(truth, args.batch)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
