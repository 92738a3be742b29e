"""What kinematics refuses.

Rm501Error
└── KinematicsError      a number that cannot be worked with (NaN, wrong shape, bad margin)
    ├── GeometryError    link lengths, limits or a wrist matrix that describe no arm; `key` names the configuration key
    └── OrientationError an orientation that five joints cannot take; `residual_deg` says by how much
"""

from __future__ import annotations

from rm501_host.errors import Rm501Error


class KinematicsError(Rm501Error):
    """A question that kinematics cannot answer, with the reason and the remedy."""


class GeometryError(KinematicsError):
    """The geometry describes no arm; `key` is the configuration key to correct."""

    def __init__(self, key: str, message: str, remedy: str) -> None:
        self.key = key
        super().__init__(f"{key}: {message}; {remedy}")


class OrientationError(KinematicsError):
    """The tool cannot point that way at that place; `residual_deg` is the smallest angle that is left."""

    def __init__(self, residual_deg: float, tolerance_deg: float, message: str) -> None:
        self.residual_deg = residual_deg
        self.tolerance_deg = tolerance_deg
        super().__init__(message)
