#!/usr/bin/env python3
"""Accuracy, coverage, seed spread and cost of vehicle reconstructions, for one or several programs.

    scripts/benchmark/vehicles.py SEQUENCES... --output OUT [--tractrix PROGRAM]... [--seeds N] [--clip VIDEO]...

SEQUENCES are folders of rendered sequences; masks and intrinsics are given. Each program runs every sequence with each
seed of its random numbers, and every clip as raw video. Finished runs are kept: use a fresh OUT for a changed program.
"""

import argparse
import json
import statistics
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from run_output import RunOutput

STAGES = ("objects", "scale")


def run(command: list[str | Path], log: Path) -> None:
    """Runs a program; its messages go to a file. Failed sequences are part of the result."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as file:
        subprocess.run([str(part) for part in command], stdout=file, stderr=file, check=False)


def cost_ms(folder: Path, num_frames: int) -> float:
    """CPU time of the stages of vehicles, milliseconds per frame."""
    stages = RunOutput(folder).run.get("stages", {})
    return 1e3 * sum(stages.get(stage, {}).get("cpu_s", 0.0) for stage in STAGES) / max(num_frames, 1)


def sequences(program: Path, roots: list[Path], seeds: int, out: Path) -> list[dict[str, Any]]:
    """One entry per sequence and seed, as `tractrix benchmark` writes it, with `seed`, `root` and `cost_ms`."""
    found = []
    for seed in range(seeds):
        for root in roots:
            folder = out / f"seed{seed}" / root.name
            run(
                [program, "benchmark", root, "--output", folder, "--seed", str(seed), "--threads", "1", "--quiet"],
                out / "log.txt",
            )
            for entry in json.loads((folder / "benchmark.json").read_text())["sequences"]:
                frames = (entry["registered"] or {}).get("num_frames", 0)
                found.append(entry | {"seed": seed, "cost_ms": cost_ms(folder / entry["folder"], frames)})
    return found


def clips(program: Path, videos: list[Path], out: Path) -> dict[str, RunOutput]:
    """The results of raw video."""
    for video in videos:
        run([program, "run", video, "--output", out / video.stem, "--threads", "1", "--quiet"], out / "log.txt")
    return {video.stem: RunOutput(out / video.stem) for video in videos}


def coverage(entries: list[dict[str, Any]]) -> str:
    """Shares of the ratios within 1, 2 and 3 of their standard deviations."""
    off = [e["scale"]["deviation"] * e["scale"]["ratio"] / e["scale"]["std"] for e in entries if e["scale"]["std"]]
    return ", ".join(f"{100 * sum(x <= k for x in off) / len(off):.0f}" for k in (1, 2, 3)) + " %"


def signed(entry: dict[str, Any]) -> float:
    """Ratio over the reference ratio."""
    return entry["scale"]["ratio"] / entry["reference_ratio"]


def seed_spread(entries: list[dict[str, Any]]) -> str:
    """Largest and median difference between the ratios of one sequence by different seeds."""
    by_name: dict[str, list[float]] = {}
    for entry in entries:
        by_name.setdefault(entry["folder"], []).append(signed(entry))
    spreads = [100 * (max(ratios) - min(ratios)) for ratios in by_name.values() if len(ratios) > 1]
    return f"{max(spreads):.2f}, {statistics.median(spreads):.2f} %" if spreads else "–"


def placed(entries: list[dict[str, Any]]) -> str:
    """Share of the frames with a clear view of the vehicle in which it has a position."""

    def frames(registered: dict[str, Any]) -> tuple[int, int]:
        if registered["num_clear"] is None:
            return registered["num_object"], registered["num_visible"]
        return registered["num_placed_clear"], registered["num_clear"]

    found, visible = (sum(numbers) for numbers in zip(*(frames(e["registered"]) for e in entries), strict=True))
    return f"{100 * found / max(visible, 1):.1f} %"


ROWS: dict[str, Callable[[list[dict[str, Any]]], str]] = {
    "trajectory error, mean, m": lambda found: f"{statistics.mean(e['trajectory_error_m'] for e in found):.4f}",
    "trajectory error, max, m": lambda found: f"{max(e['trajectory_error_m'] for e in found):.4f}",
    "error over error at the reference ratio": lambda found: (
        f"{statistics.mean(e['trajectory_error_m'] for e in found) / statistics.mean(e['floor_m'] for e in found):.3f}"
    ),
    "scale deviation, mean, %": lambda found: f"{100 * statistics.mean(e['scale']['deviation'] for e in found):.2f}",
    "σ of the ratio, mean, %": lambda found: (
        f"{100 * statistics.mean(e['scale']['std'] / e['scale']['ratio'] for e in found):.2f}"
    ),
    "within 1, 2, 3 σ": coverage,
    "between seeds, max and median": seed_spread,
    "clear frames with a position": placed,
    "CPU of objects and scale, ms per frame": lambda found: f"{statistics.mean(e['cost_ms'] for e in found):.1f}",
}


def usable(entry: dict[str, Any]) -> bool:
    """True if the sequence has a trajectory and a reference."""
    return entry["trajectory_error_m"] is not None and entry["floor_m"] is not None and entry["scale"] is not None


def table(title: str, columns: dict[str, list[dict[str, Any]]]) -> None:
    """Prints the quantities of all programs side by side."""
    print(f"\n| {title} | " + " | ".join(columns) + " |\n|---" + "|---:" * len(columns) + "|")
    kept = {name: [e for e in found if usable(e)] for name, found in columns.items()}
    failed = [f"{len(found) - len(kept[name])} of {len(found)}" for name, found in columns.items()]
    print("| failed | " + " | ".join(failed) + " |")
    for name, of in ROWS.items():
        print(f"| {name} | " + " | ".join(of(found) if found else "–" for found in kept.values()) + " |")


def each(columns: dict[str, list[dict[str, Any]]]) -> None:
    """Prints error, signed deviation and σ of every run."""
    print("\n| run | " + " | ".join(columns) + " |\n|---" + "|---:" * len(columns) + "|")
    by_run: dict[str, dict[str, str]] = {}
    for name, found in columns.items():
        for e in found:
            text = e["failure"] or "–"
            if usable(e):
                std = 100 * (e["scale"]["std"] or 0.0) / e["scale"]["ratio"]
                frames = e["registered"]["num_object"]
                text = f"{e['trajectory_error_m']:.3f} ({e['floor_m']:.3f}) m, {100 * (signed(e) - 1):+.2f} ± "
                text += f"{std:.2f} %, {frames} frames, {e['cost_ms']:.0f} ms"
            by_run.setdefault(f"{e['folder']}, seed {e['seed']}", {})[name] = text
    for row, cells in sorted(by_run.items()):
        print(f"| {row} | " + " | ".join(cells.get(name, "–") for name in columns) + " |")


def verdicts(columns: dict[str, dict[str, RunOutput]]) -> None:
    """Prints verdict counts and cost of every clip."""
    for clip in next(iter(columns.values())):
        print(f"\n| {clip} | " + " | ".join(columns) + " |\n|---" + "|---:" * len(columns) + "|")
        cells = {"verdicts": [], "CPU of objects and scale, ms per frame": []}
        for found in (outputs[clip] for outputs in columns.values()):
            states = Counter(entry.get("verdict", {}).get("state") for entry in found.objects.values())
            cells["verdicts"].append(", ".join(f"{count} {state}" for state, count in sorted(states.items(), key=str)))
            num_frames = found.run.get("input", {}).get("info", {}).get("num_frames", 0)
            cells["CPU of objects and scale, ms per frame"].append(f"{cost_ms(found.folder, num_frames):.1f}")
        for name, texts in cells.items():
            print(f"| {name} | " + " | ".join(texts) + " |")


def main() -> None:
    """Runs everything and prints the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("sequences", type=Path, nargs="*", help="folders of sequences")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--tractrix", type=Path, action="append", help="program; may be repeated")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--clip", type=Path, action="append", default=[], help="raw video; may be repeated")
    args = parser.parse_args()
    programs = {p.name: p for p in args.tractrix or [Path("target/release/tractrix")]}
    if args.sequences:
        found = {n: sequences(p, args.sequences, args.seeds, args.output / n) for n, p in programs.items()}
        each(found)
        table("all sequences", found)
    if args.clip:
        verdicts({n: clips(p, args.clip, args.output / n) for n, p in programs.items()})


if __name__ == "__main__":
    main()
