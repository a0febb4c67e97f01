"""Seeded randomness: one independent generator per item, named by its key.

An item's numbers depend on its key alone and never on what was built before
it, so leaving one item out changes no other.
"""

from __future__ import annotations

import hashlib

import numpy as np

Key = str | int | float


def digest(*key: Key) -> int:
    """A 64-bit integer that depends on every part of the key."""
    text = "/".join(repr(part) for part in key)
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "little")


def rng(*key: Key) -> np.random.Generator:
    """A generator of its own for the item named by ``key``."""
    return np.random.Generator(np.random.PCG64(digest(*key)))


def _lattice(ix: np.ndarray, iy: np.ndarray, salt: int) -> np.ndarray:
    """Uniform values in [-1, 1) on the integer lattice (a splitmix64 hash)."""
    with np.errstate(over="ignore"):
        h = ix.astype(np.int64).view(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        h ^= iy.astype(np.int64).view(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        h ^= np.uint64(salt)
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
    return (h >> np.uint64(11)).astype(np.float64) / 2.0**52 - 1.0


def noise(x: np.ndarray, y: np.ndarray, wavelength_m: float, *key: Key) -> np.ndarray:
    """Smooth value noise in [-1, 1] with the given lattice spacing; C2, never repeats."""
    salt = digest("noise", *key)
    u, v = np.asarray(x, float) / wavelength_m, np.asarray(y, float) / wavelength_m
    iu, iv = np.floor(u), np.floor(v)
    fu, fv = u - iu, v - iv
    su = fu**3 * (fu * (6 * fu - 15) + 10)
    sv = fv**3 * (fv * (6 * fv - 15) + 10)
    low = _lattice(iu, iv, salt) * (1 - su) + _lattice(iu + 1, iv, salt) * su
    high = _lattice(iu, iv + 1, salt) * (1 - su) + _lattice(iu + 1, iv + 1, salt) * su
    return low * (1 - sv) + high * sv


def fbm(x: np.ndarray, y: np.ndarray, wavelength_m: float, octaves: int, *key: Key) -> np.ndarray:
    """Sum of noise octaves, each of half the wavelength and half the height."""
    total = np.zeros(np.broadcast(x, y).shape)
    for octave in range(octaves):
        total += noise(x, y, wavelength_m / 2**octave, octave, *key) / 2**octave
    return total


def smoothstep(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below ``low``, 1 above ``high``, a cubic between."""
    t = np.clip((np.asarray(x, float) - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)
