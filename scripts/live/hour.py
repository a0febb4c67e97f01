#!/usr/bin/env python3
"""Measures the memory of `tractrix live` over a long flight: a clip that is repeated, forward and backward by turns.

    scripts/live/hour.py VIDEO OUT [--minutes M] [-- FLAGS OF tractrix live]

The clip is encoded once forward and once backward, so that the camera flies to and fro without a jump, and piped at its
own rate. The memory is sampled every second. Prints one JSON object: memory after two minutes, its range from then on,
the final positions, and the totals; OUT.rss has the samples. Needs ffmpeg.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from measure import PROGRAM, rss_mib

WARM_UP_S = 120  # from then on memory must be flat


def to_and_fro(video: Path, out: Path) -> Path:
    """The clip forward and backward, in one file."""
    found = out.with_suffix(".loop.mkv")
    graph = "[0:v]split[a][b];[b]reverse[c];[a][c]concat=n=2:v=1[v]"
    codec = ["-c:v", "libx264", "-preset", "fast", "-crf", "18", "-g", "30"]
    command = ["ffmpeg", "-v", "error", "-y", "-i", str(video), "-filter_complex", graph, "-map", "[v]", *codec]
    subprocess.run([*command, str(found)], check=True)
    return found


def main() -> None:
    """Runs, samples and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=60.0)
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    args, flags = parser.parse_args(sys.argv[1:split]), sys.argv[split + 1 :]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    loop = to_and_fro(args.video, args.out)
    form = ["-c", "copy", "-f", "mpegts", "-muxdelay", "0", "-muxpreload", "0", "-flush_packets", "1", "-"]
    paced = ["ffmpeg", "-v", "error", "-readrate", "1", "-stream_loop", "-1", "-i", str(loop)]
    source = subprocess.Popen([*paced, "-t", str(60 * args.minutes), *form], stdout=subprocess.PIPE)
    command = [PROGRAM, "live", "-", "--output", str(args.out), "--overwrite", "--no-final-run", "--quiet", *flags]
    program = subprocess.Popen(command, stdin=source.stdout)
    begin, samples = time.monotonic(), []
    with args.out.with_suffix(".rss").open("w") as log:
        while program.poll() is None:
            samples.append((time.monotonic() - begin, rss_mib(program.pid)))
            log.write(f"{samples[-1][0]:.0f} {samples[-1][1]:.1f}\n")
            log.flush()
            time.sleep(1)
    lines = [json.loads(line) for line in (args.out / "live.jsonl").read_text().splitlines()]
    # The last sample may find a process that is ending.
    late = [mib for at, mib in samples[:-1] if at >= WARM_UP_S]
    finals = [line["method"] for line in lines if line["kind"] == "vehicle" and line["state"] == "final"]
    result = {
        "exit": program.returncode,
        "minutes": round(samples[-1][0] / 60, 1),
        "rss_mib": {"max": round(max(mib for _, mib in samples)), "late": [round(min(late)), round(max(late))]}
        if late
        else None,
        "final_positions": {"all": len(finals), "by model": finals.count("model")},
        "restarts": sum(line["kind"] == "map" and not line["is_continued"] for line in lines),
        "end": lines[-1] if lines else None,
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
