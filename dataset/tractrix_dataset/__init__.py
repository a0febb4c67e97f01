"""Procedural generator of the virtual trajectory data set.

World frame: right-handed, z up, metres; x east, y north. Object frame: x
forward, y left, z up, origin on the ground below the middle of the wheelbase.
Camera frame: x right, y down, z forward. Transforms are named
``target_from_source``.
"""
