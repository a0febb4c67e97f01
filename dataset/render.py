#!/usr/bin/env python3
"""Renders one sequence of the virtual trajectory data set with its ground truth.

Can be stopped at any moment: the same command goes on where it was.
"""

from __future__ import annotations

import argparse

from tractrix_dataset import cli
from tractrix_dataset.scene import Request
from tractrix_dataset.sequence import render_sequence


def main() -> None:
    """Reads the arguments and renders."""
    parser = argparse.ArgumentParser(description=__doc__)
    cli.add_names(parser)
    cli.add_render_arguments(parser)
    arguments = parser.parse_args()
    request = Request(arguments.trajectory, arguments.vehicle, arguments.seed, arguments.frames)
    max_bytes = int(arguments.max_mib * cli.MIB)
    render_sequence(request, cli.render_options(arguments), arguments.output, max_bytes, arguments.images)


if __name__ == "__main__":
    main()
