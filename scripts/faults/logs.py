"""Receivers' logs that are damaged, huge, or want to read other files."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import strace
from common import DEMO, Bench, Tally
from damage import damaged
from defects import MODEST_MIB
from inputs import HANG_S, judged

NUM_FIXES = 40
# Ten hours at 60 fixes a second are fewer by half.
MANY_FIXES = 5_000_000
RUN = ["--masks", DEMO / "masks", "--end", "4f", "--max-dimension", "320", "--threads", "1"]


def _logs() -> dict[str, bytes]:
    """A log of every format, by its name."""
    fixes = [(k, 48.5 + 1e-5 * k, 9.25 + 2e-5 * k, 400.0 + 0.1 * k) for k in range(NUM_FIXES)]
    clock = [f"00:00:{k:02},000" for k in range(NUM_FIXES + 1)]
    points = "".join(
        f'<trkpt lat="{lat}" lon="{lon}"><ele>{up}</ele><time>2024-05-06T07:08:{k:02}Z</time></trkpt>'
        for k, lat, lon, up in fixes
    )
    texts = {
        "log.csv": "time_s,latitude,longitude,altitude\n"
        + "".join(f"{k},{lat},{lon},{up}\n" for k, lat, lon, up in fixes),
        "log.srt": "".join(
            f"{k + 1}\n{clock[k]} --> {clock[k + 1]}\n[latitude: {lat}] [longitude: {lon}] [altitude: {up}]\n\n"
            for k, lat, lon, up in fixes
        ),
        "log.gpx": f'<?xml version="1.0"?><gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>',
        "log.nmea": "".join(
            f"$GPGGA,1235{k:02},48{k:02}.038,N,00931.000,E,1,08,0.9,545.4,M,46.9,M,,\n" for k, *_ in fixes
        ),
    }
    return {name: text.encode() for name, text in texts.items()} | {"log.txt": _gpmf(fixes)}


def _gpmf(fixes: list[tuple[int, float, float, float]]) -> bytes:
    """The fixes as GoPro cameras write them, a payload a second."""

    def entry(key: bytes, kind: bytes, size: int, data: bytes) -> bytes:
        head = key + kind + bytes([size]) + (len(data) // size).to_bytes(2, "big")
        return head + data + bytes(-len(data) % 4)

    def second(k: int, lat: float, lon: float, up: float) -> bytes:
        positions = [
            entry(b"GPSF", b"L", 4, struct.pack(">I", 3)),
            entry(b"GPSU", b"c", 1, f"2405060708{k:02}.000".encode()),
            entry(b"GPSP", b"S", 2, struct.pack(">H", 154)),
            entry(b"SCAL", b"l", 4, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100)),
            entry(b"GPS5", b"l", 20, struct.pack(">5i", *(round(x) for x in (1e7 * lat, 1e7 * lon, 1e3 * up, 0, 0)))),
        ]
        scale, down = struct.pack(">h", 32767), struct.pack(">3h", 0, 32767, 0)
        gravity = [entry(b"SCAL", b"s", 2, scale), entry(b"GRAV", b"s", 6, down)]
        streams = [entry(b"STRM", b"\0", 1, b"".join(parts)) for parts in (positions, gravity)]
        return entry(b"DEVC", b"\0", 1, b"".join(streams))

    return b"".join(second(*fix) for fix in fixes)


def _hostile(secret: Path) -> dict[str, tuple[str, bytes]]:
    """Logs that are made to do harm: a name, and what is in it."""
    laughs = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
    point = '<trk><trkseg><trkpt lat="48" lon="9"><name>{}</name></trkpt></trkseg></trk></gpx>'
    return {
        "entities within entities": (
            "log.gpx",
            f'<!DOCTYPE gpx [<!ENTITY l0 "ha">{laughs}]><gpx>{point.format("&l11;")}'.encode(),
        ),
        "an entity of a file": (
            "log.gpx",
            f'<!DOCTYPE gpx [<!ENTITY e SYSTEM "file://{secret}">]><gpx>{point.format("&e;")}'.encode(),
        ),
        "a definition elsewhere": (
            "log.gpx",
            f'<!DOCTYPE gpx SYSTEM "file://{secret}"><gpx>{point.format("x")}'.encode(),
        ),
        "a million levels": ("log.gpx", b"<gpx>" + b"<a>" * 1_000_000),
        "one line of 50 MB": ("log.csv", b"time_s,latitude,longitude\n" + b"9" * 50_000_000),
        "a million columns": ("log.csv", b"a," * 1_000_000 + b"\n"),
        "zeros": ("log.csv", bytes(1_000_000)),
        "UTF-16": ("log.csv", "time_s,latitude,longitude\n0,48,9\n1,48,9\n".encode("utf-16")),
        "numbers at their ends": (
            "log.csv",
            b"time_s,latitude,longitude\n" + b"1e308,1e308,-1e308\n-1e308,nan,inf\n" * 1000,
        ),
        "times that go nowhere": ("log.csv", b"time_s,latitude,longitude\n" + b"0,48,9\n" * 10_000),
        "orders to a terminal": (
            "log.srt",
            b"1\n00:00:00,000 --> 00:00:01,000\n\x1b]0;x\x07\x1b[2J[latitude: \x1b[2J]\n\n",
        ),
        "a camera's samples beyond its end": ("log.txt", b"DEVC\0\xff\xff\xffSTRM\0\xff\xff\xffGPS5l\x14\xff\xff"),
        "a camera's million streams": ("log.txt", b"DEVC\0\xff\xff\xff" + b"STRM\0\0\0\0" * 1_000_000),
        f"{MANY_FIXES} fixes": ("log.csv", b"time_s,latitude,longitude\n" + b"0,4,9\n" * MANY_FIXES),
    }


def telemetry(bench: Bench, only: list[str]) -> Tally:
    """Logs with damage at random, and those that are made to do harm: shown, given to a run, or beside its video."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    secret = bench.path("secret.txt")
    secret.write_text("precious")
    logs, hostile = _logs(), _hostile(secret)
    cases = [*hostile, *(f"damage {number}" for number in range(bench.number or 100))]
    for case in cases[: bench.number or len(cases)]:
        name, content = hostile.get(case) or rng.choice(sorted(logs.items()))
        folder = bench.path("given")
        folder.mkdir()
        video = folder / f"{Path(name).stem}.mp4"
        video.symlink_to(DEMO / "video.mp4")
        log = folder / name
        log.write_bytes(content if case in hostile else damaged(content, rng))
        run = ["run", video, "--output", bench.path("out"), *RUN]
        how = rng.choice(["shown", "shown", "given", "beside"])
        command = {"shown": ["telemetry", log], "given": [*run, "--telemetry", log], "beside": run}[how]
        outcome, calls = strace.traced(bench, command, time_limit_s=HANG_S)
        too_much = f"took {outcome.peak_mib:.0f} MiB" if outcome.peak_mib > MODEST_MIB else None
        problem = judged(outcome) or too_much or strace.problem(calls, bench.folder / "out")
        problem = problem or ("reads a file that the log names" if str(secret) in strace.opened(calls) else None)
        problem = problem or ("prints an escape" if "\x1b" in outcome.stdout + outcome.stderr else None)
        tally.add(f"{case}: {name}, {how}", problem, outcome)
    return tally
