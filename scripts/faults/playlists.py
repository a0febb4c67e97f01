"""Texts that name other files, in the place of a video: what they name is not opened."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import strace
from common import DEMO, FAILED, Bench, Outcome, Tally

# More than a refusal takes under strace on a slow machine; what waits for a list to grow waits for ever.
HANG_S = 30.0
FRAMES = ["--detector", "none", "--motion", "off", "--end", "3f", "--max-dimension", "320", "--threads", "1"]
HEAD = "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXT-X-MEDIA-SEQUENCE:0\n#EXTINF:2.0,\n"
LISTS = {
    "hls": HEAD + "{target}\n#EXT-X-ENDLIST\n",
    "hls, live": HEAD + "{target}\n",
    "hls, a key": HEAD.replace("#EXTINF", '#EXT-X-KEY:METHOD=AES-128,URI="{target}"\n#EXTINF')
    + "{target}\n#EXT-X-ENDLIST\n",
    "hls, a map": HEAD.replace("#EXTINF", '#EXT-X-MAP:URI="{target}"\n#EXTINF') + "{target}\n#EXT-X-ENDLIST\n",
    "hls, master": "#EXTM3U\n#EXT-X-STREAM-INF:BANDWIDTH=1280000\n{target}\n",
    "ffconcat": "ffconcat version 1.0\nfile '{target}'\n",
    "dash": '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static" '
    'mediaPresentationDuration="PT2S" profiles="urn:mpeg:dash:profile:isoff-on-demand:2011"><Period>'
    '<AdaptationSet mimeType="video/mp4"><Representation id="1" bandwidth="1000" codecs="avc1.4d401e" '
    'width="320" height="240"><BaseURL>{target}</BaseURL></Representation></AdaptationSet></Period></MPD>\n',
    "sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n"
    "a=rtpmap:96 H264/90000\na=control:{target}\n",
    "rtsp": "RTSPtext\nrtsp://127.0.0.1:9/{target}\n",
    "asx": '<ASX version="3.0"><ENTRY><REF HREF="{target}"/></ENTRY></ASX>\n',
    "smil": '<smil><body><video src="{target}"/></body></smil>\n',
    "svg": '<svg xmlns="http://www.w3.org/2000/svg"><image href="{target}"/></svg>\n',
    "vobsub": "# VobSub index file, v7 (do not modify this line!)\nid: en, index: 0\n"
    "timestamp: 00:00:00:000, filepos: 000000000\n",
    "imf": '<?xml version="1.0"?><AssetMap xmlns="http://www.smpte-ra.org/schemas/429-9/2007/AM"><AssetList><Asset><Id>urn:uuid:'
    "00000000-0000-0000-0000-000000000001</Id><ChunkList><Chunk><Path>{target}</Path></Chunk></ChunkList></Asset></AssetList>"
    "</AssetMap>\n",
    "pls": "[playlist]\nFile1={target}\nNumberOfEntries=1\n",
    "address": "{target}\n",
}
ENDINGS = ("mp4", "m3u8", "mpd", "ffconcat", "sdp", "idx", "txt", "mkv", "")


def playlists(bench: Bench, only: list[str]) -> Tally:
    """Lists of every kind under every ending, that name a video in every way, given to several commands."""
    tally, rng = Tally(bench.seed), random.Random(bench.seed)
    private = bench.path("private")
    private.mkdir()
    for name in ("video.mp4", "video.ts", "video.sub"):
        shutil.copy(DEMO / "video.mp4", private / name)
    cases = [(kind, ending) for kind in LISTS for ending in ENDINGS if not only or kind in only]
    rng.shuffle(cases)
    for kind, ending in cases[: bench.number or len(cases)]:
        folder = bench.path("given")
        folder.mkdir()
        shutil.copy(DEMO / "video.mp4", folder / "near.mp4")
        target = rng.choice(["near.mp4", *_named(private / rng.choice(["video.mp4", "video.ts"]))])
        given = folder / f"list.{ending}".rstrip(".")
        given.write_text(LISTS[kind].format(target=target))
        (folder / "list.sub").write_bytes(b"x")
        command = rng.choice([_sfm, _telemetry, _batch])(bench, given)
        outcome, calls = strace.traced(bench, command, time_limit_s=HANG_S)
        tally.add(f"{command[0]}: {kind} as .{ending}, {target}", _problem(outcome, calls, given, bench), outcome)
    return tally


def _named(path: Path) -> list[str]:
    """Ways to name a file."""
    above = f"../{path.parent.name}/{path.name}"
    return [
        str(path),
        f"file:{path}",
        f"file://{path}",
        above,
        f"subfile,,start,0,end,0,,:{path}",
        f"concat:{path}|{path}",
        f"crypto:{path}",
        f"cache:{path}",
        f"data:,{path}",
        "http://127.0.0.1:9/video.mp4",
        "tcp://127.0.0.1:9",
    ]


def _sfm(bench: Bench, given: Path) -> list[str | Path]:
    return ["sfm", given, "--output", bench.path("out"), *FRAMES]


def _telemetry(bench: Bench, given: Path) -> list[str | Path]:
    return ["telemetry", given]


def _batch(bench: Bench, given: Path) -> list[str | Path]:
    jobs = bench.path("jobs.txt")
    jobs.write_text(f"{given}\n")
    return ["batch", jobs, "--output", bench.path("out"), "--jobs", "1", *FRAMES]


def _problem(outcome: Outcome, calls: list[str], given: Path, bench: Bench) -> str | None:
    others = [
        path for path in strace.opened(calls) if Path(path).name in ("near.mp4", "video.mp4", "video.ts", "list.sub")
    ]
    if others:
        return f"opens {others[0]}"
    if outcome.timed_out or outcome.code != FAILED or not outcome.is_clean:
        return outcome.described()
    return strace.problem(calls, bench.folder / "out")
