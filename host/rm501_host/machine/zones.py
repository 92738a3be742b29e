"""Keep-out zones for motions that are no programs: moves, trajectories, going to a teach point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rm501_host.errors import RefusedError
from rm501_host.machine.machine import Machine
from rm501_host.planner import Piece, PieceKind
from rm501_host.preflight.keep_out import KeepOut

_SAMPLE_S = 0.01
"""Spacing at which a motion is looked at: 1 mm at 100 mm/s."""
_FEWEST, _MOST = 64, 20_000


def refuse_zones(machine: Machine, pieces: tuple[Piece, ...]) -> None:
    """Raise RefusedError naming what would enter which zone and when; nothing has moved then."""
    zones = KeepOut(machine.config)
    if zones.is_empty:
        return
    for piece in pieces:
        if piece.kind is not PieceKind.MOTION:
            continue
        time_s = sample_times(piece)
        found = zones.first_entry(piece.arm or machine.arm, piece.q_deg(time_s), 0.0)
        if found is None:
            continue
        row, what, depth_mm = found
        if row == 0:
            raise RefusedError(f"the arm stands in a keep-out zone ({what}, by {depth_mm:.1f} mm); jog it out first")
        raise RefusedError(
            f"{what} at {time_s[row]:.2f} s, by {depth_mm:.1f} mm; nothing moved; go round by another pose"
        )


def sample_times(piece: Piece) -> NDArray[np.float64]:
    """Times (n,) in s from the start of a piece, close enough for checks that have no closed form."""
    count = int(np.clip(np.ceil(piece.duration_s / _SAMPLE_S), _FEWEST, _MOST))
    return np.linspace(0.0, piece.duration_s, count + 1)
