"""Seeded randomness, one independent stream per named source.

Every source of chance on the bench (a switch, a motor's friction, a line) draws from its own stream, derived from the
bench's seed and the source's name. Adding a source, or drawing more from one, never changes what another sees.
"""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """The generator of the source `name` on the bench with `seed`; the same on every machine and in every process."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))
