#!/usr/bin/env python3
"""Kills `tractrix live` at random moments and checks what it leaves.

    scripts/live/kill.py VIDEO OUT [--times N] [-- FLAGS OF tractrix live]

After each SIGKILL the recording must be the beginning of what was sent, FFmpeg must decode it, and every line of
live.jsonl must be JSON. Prints one JSON object. Needs ffmpeg.
"""

import argparse
import json
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

from measure import PROGRAM, paced


def one(video: Path, out: Path, seconds: float, flags: list[str]) -> tuple[int, int]:
    """Kills one run; gives the size of its recording and the number of its lines."""
    # A program that is killed before it has begun leaves the files of the one before.
    for earlier in [*out.glob("recording.*"), out / "live.jsonl"]:
        earlier.unlink(missing_ok=True)
    command = [PROGRAM, "live", "-", "--output", str(out), "--overwrite", "--no-final-run", "--quiet", *flags]
    program = subprocess.Popen(command, stdin=subprocess.PIPE)
    source, sent = paced(video, None), bytearray()
    assert source.stdout and program.stdin

    def relay() -> None:
        assert source.stdout and program.stdin
        try:
            while chunk := source.stdout.read1(1 << 16):
                sent.extend(chunk)
                program.stdin.write(chunk)
                program.stdin.flush()
        except BrokenPipeError:
            pass

    thread = threading.Thread(target=relay)
    thread.start()
    time.sleep(seconds)
    program.kill()
    program.wait()
    source.kill()
    thread.join()
    recordings = list(out.glob("recording.*"))
    if not recordings:
        return 0, 0
    data = recordings[0].read_bytes()
    assert bytes(sent[: len(data)]) == data, f"recorded {len(data)} bytes are not the first of {len(sent)} sent"
    if len(data) > 1 << 16:
        decoded = subprocess.run(
            [
                "ffprobe",
                "-v",
                "quiet",
                "-count_frames",
                "-show_entries",
                "stream=nb_read_frames",
                "-of",
                "csv=p=0",
                str(recordings[0]),
            ],
            capture_output=True,
            text=True,
            check=True,
        )
        assert int(decoded.stdout.split()[0].rstrip(",")) > 0, "nothing can be decoded"
    lines = (out / "live.jsonl").read_text().splitlines() if (out / "live.jsonl").exists() else []
    for line in lines:
        json.loads(line)
    return len(data), len(lines)


def main() -> None:
    """Kills, checks and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--times", type=int, default=20)
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    args, flags = parser.parse_args(sys.argv[1:split]), sys.argv[split + 1 :]
    pick = random.Random(0)
    found = [one(args.video, args.out, pick.uniform(0.05, 6.0), flags) for _ in range(args.times)]
    sizes, lines = zip(*found, strict=True)
    print(
        json.dumps(
            {
                "kills": len(found),
                "without_recording": sizes.count(0),
                "bytes": [min(sizes), max(sizes)],
                "lines": [min(lines), max(lines)],
            }
        )
    )


if __name__ == "__main__":
    main()
