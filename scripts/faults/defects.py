"""Every defect that was ever found by these means, with its command: none may come back."""

from __future__ import annotations

import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import networks
from common import DEMO, DONE, FAILED, WRONG_USE, Bench, Outcome, Tally, leftovers, run

Case = Callable[[Bench], tuple[Outcome, str | None]]
CASES: dict[str, Case] = {}
# More than a run of a few frames needs, and far less than what the files here promise.
MODEST_MIB = 700


def case(name: str) -> Callable[[Case], Case]:
    """Lists a defect under its name."""

    def listed(function: Case) -> Case:
        CASES[name] = function
        return function

    return listed


def work(bench: Bench, only: list[str]) -> Tally:
    """Tries all defects, or those whose names begin like one of `only`."""
    tally = Tally(bench.seed)
    for name, function in CASES.items():
        if only and not any(name.startswith(wanted) for wanted in only):
            continue
        outcome, problem = function(bench)
        if outcome.timed_out or "panicked" in outcome.stderr or (outcome.code < 0):
            problem = outcome.described()
        print(f"{'BAD ' if problem else 'good'} {name}: {problem or outcome.described()}"[:300], flush=True)
        tally.add(name, problem, outcome)
    return tally


def refused(outcome: Outcome, *words: str, codes: tuple[int, ...] = (FAILED, WRONG_USE)) -> str | None:
    """What is wrong with a refusal: another code, or words that are not said."""
    missing = [word for word in words if word not in outcome.stderr]
    if outcome.code not in codes:
        return f"ended with {outcome.code}, {outcome.stderr.strip()[-200:]}"
    return f"does not say {missing}: {outcome.stderr.strip()[-200:]}" if missing else None


def png(width: int, height: int, pixel: Callable[[int, int], bytes] | None = None, colour_type: int = 2) -> bytes:
    """A PNG picture of 8 bits; black where nobody says otherwise."""
    depth = {0: 1, 2: 3}[colour_type]
    packed = zlib.compressobj(6)
    rows = b""
    for y in range(height):
        line = b"".join(pixel(x, y) for x in range(width)) if pixel else bytes(width * depth)
        rows += packed.compress(b"\0" + line)
    rows += packed.flush()

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    head = struct.pack(">IIBBBBB", width, height, 8, colour_type, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def pictures(bench: Bench, name: str, names: list[str]) -> Path:
    """A folder of small pictures with something to see."""
    folder = bench.path(name)
    folder.mkdir(parents=True)
    for k, file in enumerate(names):
        texture = png(160, 120, lambda x, y, k=k: bytes([((x + 3 * k) * 37 ^ y * 91) & 255, (x * y) & 255, 90]))
        (folder / file).write_bytes(texture)
    return folder


@case("H1 a folder of the user's own in OUT")
def own_folder(bench: Bench) -> tuple[Outcome, str | None]:
    out = bench.path("out")
    photo = out / "objects/my_photos/a.jpg"
    photo.parent.mkdir(parents=True)
    photo.write_text("x")
    outcome = bench.run(*bench.command(out))
    return outcome, refused(outcome, "not empty", codes=(WRONG_USE,)) or (None if photo.exists() else "it is gone")


@case("H2 an input that lies in OUT")
def input_in_output(bench: Bench) -> tuple[Outcome, str | None]:
    out = bench.path("out")
    bench.run(*bench.command(out))
    masks = sorted((out / "tracks/1").iterdir())
    command = [part if part != DEMO / "masks" else out / "tracks/1" for part in bench.command(out)]
    outcome = bench.run(*command)
    still = sorted((out / "tracks/1").iterdir()) if (out / "tracks/1").is_dir() else []
    return outcome, refused(outcome, "inside the output folder") or (None if still == masks else "masks are gone")


@case("H3 links in OUT")
def links(bench: Bench) -> tuple[Outcome, str | None]:
    out, profile = bench.path("out"), bench.path("profile")
    profile.write_text("precious")
    (out / ".tractrix").mkdir(parents=True)
    (out / ".tractrix/lock").symlink_to(profile)
    outcome = bench.run(*bench.command(out))
    return outcome, refused(outcome) or (None if profile.read_text() == "precious" else "the link's target was written")


def told(outcome: Outcome, *words: str) -> str | None:
    """What is wrong with an evaluation that cannot use a part: that must stand in its table."""
    said = outcome.stdout + outcome.stderr
    missing = [word for word in words if word not in said]
    if outcome.code not in (DONE, FAILED) or missing or "NaN" in said:
        return f"ended with {outcome.code}, does not say {missing}: {said.strip()[-200:]}"
    return None


def finished(bench: Bench, frames: int = 8) -> Path:
    """A finished run, kept between cases."""
    out = bench.folder / f"finished-{frames}"
    if not (out / "report.html").exists():
        outcome = bench.run(*bench.command(out, frames=frames))
        assert outcome.code == DONE, outcome.stderr
    return out


def changed_run(bench: Bench, change: Callable[[dict], None]) -> Path:
    """A copy of a finished run whose trajectories are changed."""
    out = bench.path("changed")
    shutil.copytree(finished(bench, 60), out)
    path = out / "trajectories.json"
    trajectories = json.loads(path.read_text())
    change(trajectories)
    path.write_text(json.dumps(trajectories))
    return out


@case("M1 a trajectory at 1e200")
def far_trajectory(bench: Bench) -> tuple[Outcome, str | None]:
    def change(trajectories: dict) -> None:
        for frame in trajectories["objects"][0]["frames"]:
            frame["world_from_object"]["translation"] = [1e200, 0.0, 0.0]
            frame["position"] = [1e200, 0.0, 0.0]

    outcome = bench.run("evaluate", changed_run(bench, change), "--truth", DEMO)
    return outcome, told(outcome, "trajectories.json")


@case("M1 a scale ratio of 1e308")
def far_ratio(bench: Bench) -> tuple[Outcome, str | None]:
    def change(trajectories: dict) -> None:
        trajectories["objects"][0]["scale"]["ratio"] = 1e308
        for frame in trajectories["objects"][0]["frames"]:
            frame["world_from_object"]["scale"] = 1e308

    outcome = bench.run("evaluate", changed_run(bench, change), "--truth", DEMO)
    return outcome, told(outcome, "trajectories.json")


def changed_truth(bench: Bench, name: str, change: Callable[[bytes], bytes]) -> Path:
    """A copy of the demo with one file changed."""
    truth = bench.path("truth")
    shutil.copytree(DEMO, truth)
    (truth / name).write_bytes(change((truth / name).read_bytes()))
    return truth


@case("M1 a vertex of the truth's mesh at 1e200")
def far_vertex(bench: Bench) -> tuple[Outcome, str | None]:
    mesh = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1e200 0 0\n0 1 0\n3 0 1 2\n"
    )
    truth = changed_truth(bench, "object_mesh.ply", lambda _: mesh.encode())
    outcome = bench.run("evaluate", finished(bench, 60), "--truth", truth)
    return outcome, told(outcome, "object_mesh.ply")


@case("M1 a camera of the truth at 1e200")
def far_camera(bench: Bench) -> tuple[Outcome, str | None]:
    def change(content: bytes) -> bytes:
        scene = json.loads(content)
        scene["frames"][3]["T_world_camera"][0][3] = 1e200
        return json.dumps(scene).encode()

    outcome = bench.run("evaluate", finished(bench), "--truth", changed_truth(bench, "scene.json", change))
    return outcome, refused(outcome, "scene.json")


for key, value in [
    ("objects.front_end.video.min_distance_px", "4294967295"),
    ("background.front_end.video.min_distance_px", "1e308"),
    ("background.mapper.min_error_px", "1e9"),
    ("background.mapper.max_error_px", "-1"),
    ("ground.num_neighbors", "1000000000"),
]:

    def extreme(bench: Bench, key: str = key, value: str = value) -> tuple[Outcome, str | None]:
        outcome = bench.run(*bench.command(bench.path("out"), "--set", f"{key}={value}"))
        return outcome, refused(outcome, key.rsplit(".", 1)[1], codes=(WRONG_USE,))

    CASES[f"M2 {key}={value}"] = extreme


for label, name in [("a leading blank", " 00002.png"), ("a newline", "00\n02.png")]:

    def odd_name(bench: Bench, name: str = name) -> tuple[Outcome, str | None]:
        folder = pictures(bench, "frames", ["00000.png", "00001.png", name])
        outcome = bench.run("sfm", folder, "--output", bench.path("out"), "--fps", "10")
        said = [line for line in outcome.stderr.splitlines() if "skipped" in line and "file name" in line]
        return outcome, None if said else f"says nothing of the name: {outcome.described()}"

    CASES[f"M3 a frame's name with {label}"] = odd_name


@case("M4a a network that declares an input of 100000²")
def huge_network(bench: Bench) -> tuple[Outcome, str | None]:
    network = bench.path("huge.onnx")
    network.write_bytes(networks.yolo(side=100_000))
    given = ["--segmentation-model", network, "--end", "3f", "--max-dimension", "480", "--threads", "1"]
    command = ["run", DEMO / "video.mp4", "--output", bench.path("out"), *given]
    outcome = bench.run(*command, time_limit_s=60.0)
    too_much = f"took {outcome.peak_mib:.0f} MiB" if outcome.peak_mib > MODEST_MIB else None
    return outcome, too_much or refused(outcome, "huge.onnx", "--memory-limit")


@case("M4b three pictures of 13000², under a limit of 1 GiB")
def huge_pictures(bench: Bench) -> tuple[Outcome, str | None]:
    folder = bench.path("frames")
    folder.mkdir()
    content = png(13000, 13000)
    for k in range(3):
        (folder / f"{k}.png").write_bytes(content)
    command = ["sfm", folder, "--output", bench.path("out"), "--fps", "10", "--memory-limit", "1GiB"]
    outcome = bench.run(*command, time_limit_s=60.0)
    too_much = f"took {outcome.peak_mib:.0f} MiB" if outcome.peak_mib > 1024 else None
    return outcome, too_much or refused(outcome, "13000", "--max-dimension")


@case("M4c a table of times that promises 50 million frames")
def huge_table(bench: Bench) -> tuple[Outcome, str | None]:
    content = bytearray((DEMO / "video.mp4").read_bytes())
    at = content.index(b"stts")
    content[at + 12 : at + 16] = struct.pack(">I", 49_999_999)
    video = bench.path("table.mp4")
    video.write_bytes(content)
    command = [part if part != DEMO / "video.mp4" else video for part in bench.command(bench.path("out"))]
    outcome = bench.run(*command)
    return outcome, f"took {outcome.peak_mib:.0f} MiB" if outcome.peak_mib > 300 else None


@case("M4d --threads 1000000")
def many_threads(bench: Bench) -> tuple[Outcome, str | None]:
    outcome = bench.run(
        "run", DEMO / "video.mp4", "--output", bench.path("out"), "--threads", "1000000", time_limit_s=30.0
    )
    return outcome, refused(outcome, "threads", codes=(WRONG_USE,))


@case("L1 temporary files of a killed process")
def temporary_files(bench: Bench) -> tuple[Outcome, str | None]:
    out = bench.path("out")
    shutil.copytree(finished(bench), out)
    folders = [path for path in (out / ".tractrix").iterdir() if path.is_dir() and path.name.startswith("features-")]
    for folder in [out / ".tractrix", *folders]:
        (folder / ".tractrix-abc123").write_text("half")
    outcome = bench.run(*bench.command(out))
    left = leftovers(out)
    return outcome, f"left: {left}" if left else refused(outcome, codes=(DONE,))


@case("L2 what is no picture among the frames")
def odd_entries(bench: Bench) -> tuple[Outcome, str | None]:
    folder = pictures(bench, "frames", ["00000.png", "00001.png", "00003.png"])
    (folder / "00002.png").symlink_to("nowhere.png")
    os.mkfifo(folder / "00004.png")
    (folder / "00005.png").mkdir()
    (folder / os.fsdecode(b"00006\xff.png")).write_bytes(b"x")
    out = bench.path("out")
    outcome = bench.run("sfm", folder, "--output", out, "--fps", "10", time_limit_s=60.0)
    silent = [name for name in ["00002.png", "00004.png", "00005.png", "00006"] if name not in outcome.stderr]
    listed = out / ".tractrix/frames-list.json"
    frames = {frame["name"]: frame["id"] for frame in json.loads(listed.read_text())} if listed.exists() else {}
    moved = None if frames.get("00003.png") == 3 else f"00003.png is frame {frames.get('00003.png')}"
    return outcome, f"says nothing of {silent}" if silent else moved


@case("L3 a first picture of another size")
def odd_first(bench: Bench) -> tuple[Outcome, str | None]:
    folder = pictures(bench, "frames", [f"{k:05}.png" for k in range(1, 8)])
    (folder / "00000.png").write_bytes(png(16, 16))
    out = bench.path("out")
    outcome = bench.run("sfm", folder, "--output", out, "--fps", "10")
    listed = out / ".tractrix/frames-list.json"
    frames = len(json.loads(listed.read_text())) if listed.exists() else 0
    return outcome, None if frames == 7 else f"{frames} frames are taken of 7 that fit together"


def special(bench: Bench, name: str, command: Callable[[Path], list[str | Path]], target: str | None = None) -> Outcome:
    """Runs the program with a pipe, or a device, where it expects a file."""
    path = bench.path(name)
    if target:
        path.symlink_to(target)
    else:
        os.mkfifo(path)
    return bench.run(*command(path), time_limit_s=20.0)


def given(bench: Bench, flag: str, path: Path) -> list[str | Path]:
    """A short run with one more file."""
    return ["run", DEMO / "video.mp4", "--output", bench.path("out"), "--end", "3f", flag, path]


SPECIAL: dict[str, tuple[str, Callable[[Bench, Path], list[str | Path]]]] = {
    "the video": ("video.mp4", lambda bench, path: ["run", path, "--output", bench.path("out")]),
    "a mask": ("masks", lambda bench, path: []),
    "--segmentation-model": ("net.onnx", lambda bench, path: given(bench, "--segmentation-model", path)),
    "--ground-model": ("net.onnx", lambda bench, path: given(bench, "--ground-model", path)),
    "--flow-model": ("net.onnx", lambda bench, path: given(bench, "--flow-model", path)),
    "--detector": ("net.onnx", lambda bench, path: given(bench, "--detector", path)),
    "--options": ("o.json", lambda bench, path: given(bench, "--options", path)),
    "--intrinsics": ("cameras.txt", lambda bench, path: given(bench, "--intrinsics", path)),
    "--background-model": ("model.nvm", lambda bench, path: given(bench, "--background-model", path)),
    "convert": ("model.nvm", lambda bench, path: ["convert", path, bench.path("copy"), "--to", "colmap-text"]),
    "bal": ("problem.txt", lambda bench, path: ["bal", path]),
    "telemetry": ("log.csv", lambda bench, path: ["telemetry", path]),
}

for what, (name, command) in SPECIAL.items():
    for target in [None, "/dev/zero"]:
        if what == "a mask":
            continue

        def at(
            bench: Bench,
            name: str = name,
            command: Callable[[Bench, Path], list[str | Path]] = command,
            target: str | None = target,
        ) -> tuple[Outcome, str | None]:
            outcome = special(bench, name, lambda path: command(bench, path), target)
            too_much = f"took {outcome.peak_mib:.0f} MiB" if outcome.peak_mib > MODEST_MIB else None
            return outcome, too_much or refused(outcome, name)

        CASES[f"L4 {target or 'a pipe'} as {what}"] = at


@case("L4 a pipe as a mask")
def pipe_as_mask(bench: Bench) -> tuple[Outcome, str | None]:
    masks = bench.path("masks")
    masks.mkdir()
    for k in range(8):
        shutil.copy(DEMO / "masks" / f"{k:05}.png", masks)
    (masks / "00003.png").unlink()
    os.mkfifo(masks / "00003.png")
    command = [part if part != DEMO / "masks" else masks for part in bench.command(bench.path("out"))]
    outcome = bench.run(*command, time_limit_s=30.0)
    return outcome, None if "00003.png" in outcome.stderr else refused(outcome, "00003.png")


@case("L4 a pipe as a file of the truth")
def pipe_as_truth(bench: Bench) -> tuple[Outcome, str | None]:
    truth = bench.path("truth")
    shutil.copytree(DEMO, truth)
    (truth / "object_mesh.ply").unlink()
    os.mkfifo(truth / "object_mesh.ply")
    outcome = bench.run("evaluate", finished(bench, 60), "--truth", truth, time_limit_s=60.0)
    return outcome, told(outcome, "object_mesh.ply")


@case("L5 OUT is the folder of images")
def output_is_input(bench: Bench) -> tuple[Outcome, str | None]:
    folder = pictures(bench, "frames", ["0.png", "1.png", "2.png"])
    outcome = bench.run("sfm", folder, "--output", folder, "--fps", "10")
    return outcome, refused(outcome)


@case("L6 a full disk names the file that did not fit")
def full_disk(bench: Bench) -> tuple[Outcome, str | None]:
    mount = bench.path("small")
    mount.mkdir()
    script = f'mount -t tmpfs -o size=200k none {mount} && exec "$@"'
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh", bench.program]
    outcome = run([*command, *bench.command(mount / "out")])
    if "unshare" in outcome.stderr or "mount:" in outcome.stderr:
        outcome.code, outcome.stderr = FAILED, "not tried: no mounts can be made here"
        return outcome, None
    first = "run.json" in outcome.stderr.split("No space")[0]
    return outcome, "names run.json" if first else refused(outcome, "No space", "free some space", codes=(FAILED,))


@case("L7 a byte order mark before JSON and COLMAP's text")
def byte_order_mark(bench: Bench) -> tuple[Outcome, str | None]:
    mark = b"\xef\xbb\xbf"
    options = bench.path("options.json")
    options.write_bytes(mark + b'{"seed": 3}')
    outcome = bench.run(*bench.command(bench.path("out"), "--options", options))
    if outcome.code != DONE:
        return outcome, outcome.described()
    model = bench.path("model")
    shutil.copytree(finished(bench) / "background", model)
    for name in ["cameras.txt", "images.txt", "points3D.txt"]:
        (model / name).write_bytes(mark + (model / name).read_bytes())
    outcome = bench.run("convert", model, bench.path("copy"), "--to", "colmap-binary")
    return outcome, refused(outcome, codes=(DONE,))


@case("L9 --only-object of a vehicle that is not there")
def unknown_object(bench: Bench) -> tuple[Outcome, str | None]:
    outcome = bench.run(*bench.command(bench.path("out"), "--only-object", "77"))
    return outcome, None if "77" in outcome.stderr else "says nothing of 77"


@case("L10 Ctrl-C says how to go on")
def interrupted(bench: Bench) -> tuple[Outcome, str | None]:
    outcome = bench.run(*bench.command(bench.path("out"), frames=60), after=(0.8, 2))
    return outcome, refused(outcome, "same command resumes", codes=(130,))


def copied(bench: Bench) -> Path:
    """A copy of a finished run."""
    out = bench.path("copied")
    shutil.copytree(finished(bench), out)
    return out


@case("own files: a feature's view that is not there")
def foreign_view(bench: Bench) -> tuple[Outcome, str | None]:
    output = copied(bench)
    file = next((output / ".tractrix").glob("features-*/background.bin"))
    content = bytearray(file.read_bytes())
    # The last feature of the last track: its view is the last one, and the number of the feature has one byte or two.
    content[max(content.rfind(7, len(content) - 3), 0)] = 0x7F
    file.write_bytes(content)
    outcome = bench.run(*bench.command(output, "--set", "background.mapper.max_error_px=2.5"))
    return outcome, refused(outcome, "background.bin", f"delete {file.parent}", codes=(FAILED,))


@case("own files: one is deleted")
def deleted_features(bench: Bench) -> tuple[Outcome, str | None]:
    output = copied(bench)
    file = next((output / ".tractrix").glob("features-*/background.bin"))
    file.unlink()
    outcome = bench.run(*bench.command(output, "--set", "background.mapper.max_error_px=2.5"))
    return outcome, refused(outcome, "missing", f"delete {file.parent}", codes=(FAILED,))


@case("own files: a frame's name that leads out of the folder")
def name_leads_out(bench: Bench) -> tuple[Outcome, str | None]:
    output, escaped = copied(bench), bench.path("escaped.jpg.png")
    state = output / ".tractrix"
    frames = json.loads((state / "frames-list.json").read_text())
    frames[3]["name"] = "../" * 12 + str(bench.folder / "escaped.jpg")[1:]
    (state / "frames-list.json").write_text(json.dumps(frames))
    (state / "track.json").unlink()
    outcome = bench.run(*bench.command(output))
    return outcome, "a file was written outside" if escaped.exists() else refused(outcome, "not a frame name")
