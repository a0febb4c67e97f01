#!/usr/bin/env python3
"""Bundle adjustment beside Ceres, in turns on the same machine: cost, iterations, best CPU and wall seconds.

    scripts/bal/compare.py PROBLEM... [--ceres ./ceres_bal] [--tractrix target/release/tractrix] [--rounds 5]
                           [--undisturbed]

Beside other work, wall times mean little, and CPU times are too high. --undisturbed runs every program under
`chrt -f 20` (needs root): for its fraction of a second no other process takes a processor from it. Ceres is built from
ceres_bal.cc beside this file.
"""

import argparse
import json
import os
import subprocess
from typing import Any

Commands = dict[tuple[str, str], list[str]]


def measure(commands: Commands, rounds: int) -> dict[tuple[str, str], dict[str, Any]]:
    """Runs the commands in turns; the fastest of each, with the fastest wall time of all its runs."""
    best = {}
    for _ in range(rounds):
        for name, command in commands.items():
            result = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            seen = best.setdefault(name, result)
            seen["solve_cpu_s"] = min(seen["solve_cpu_s"], result["solve_cpu_s"])
            seen["solve_wall_s"] = min(seen["solve_wall_s"], result["solve_wall_s"])
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problems", nargs="+")
    parser.add_argument("--tractrix", default="target/release/tractrix")
    parser.add_argument("--ceres", help="the program built from ceres_bal.cc; left out if not given")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--undisturbed", action="store_true", help="with real-time priority; needs root")
    args = parser.parse_args()

    print("| problem | program | threads | final cost | iterations | CPU s | wall s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for problem in args.problems:
        commands: Commands = {}
        for threads in "1", "2":
            commands["tractrix", threads] = [args.tractrix, "bal", problem, "--json", "--threads", threads]
            if args.ceres:
                for solver in "dense", "sparse":
                    commands[f"Ceres {solver}", threads] = [args.ceres, problem, solver, threads]
        if args.undisturbed:
            commands = {name: ["chrt", "-f", "20", *command] for name, command in commands.items()}
        for (program, threads), r in sorted(measure(commands, args.rounds).items(), reverse=True):
            name = os.path.basename(problem).removesuffix(".txt")
            print(
                f"| {name} | {program} | {threads} | {r['final_cost']:.3f} | {r['iterations']} "
                f"| {r['solve_cpu_s']:.3f} | {r['solve_wall_s']:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
