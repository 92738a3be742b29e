"""One owner of motion at a time.

A client takes the lease and keeps it until it gives it back or goes away; or it just commands a motion, which takes the
lease for as long as that motion lasts. Whoever wants to start another motion gets LeaseHeldError naming the owner.
Stopping and holding need no lease. Guiding a motion that is under way (resume, abort, override, reset) is refused only
while another client keeps the lease on purpose: the one who started a program from a terminal need not be the one
who resumes it from another.

    LeaseHeldError(RefusedError)
"""

from __future__ import annotations

from dataclasses import dataclass

from rm501_host.errors import RefusedError


@dataclass(frozen=True, slots=True)
class Owner:
    """Who moves the arm: an id that is unique for each connection, and a name for people."""

    id: int
    name: str


class LeaseHeldError(RefusedError):
    """Somebody else owns the motion; `owner` says who."""

    def __init__(self, owner: Owner) -> None:
        super().__init__(
            f"{owner.name} (client {owner.id}) owns the motion; wait until it has given the lease back, or stop the arm"
        )
        self.owner = owner


class MotionLease:
    """Who owns the motion now."""

    def __init__(self) -> None:
        self._owner: Owner | None = None
        self._kept = False
        self._moving = False

    @property
    def owner(self) -> Owner | None:
        """The owner, None when the lease is free."""
        return self._owner

    def take(self, owner: Owner) -> None:
        """Take the lease until it is given back; raises LeaseHeldError."""
        self.require(owner)
        self._owner = owner
        self._kept = True

    def give_back(self, owner: Owner) -> None:
        """Give the lease back; a motion under way keeps it until it ends. Nothing happens for anybody else."""
        if self._owner is not None and self._owner.id == owner.id:
            self._kept = False
            self._settle()

    def begin_motion(self, owner: Owner) -> None:
        """A motion of `owner` starts; raises LeaseHeldError."""
        self.require(owner)
        self._owner = owner
        self._moving = True

    def end_motion(self) -> None:
        """The motion is over; the lease becomes free unless it was taken on purpose."""
        self._moving = False
        self._settle()

    def require(self, owner: Owner) -> None:
        """Raise LeaseHeldError when somebody else owns the motion."""
        if self._owner is not None and self._owner.id != owner.id:
            raise LeaseHeldError(self._owner)

    def require_control(self, owner: Owner) -> None:
        """Raise LeaseHeldError when somebody else keeps the lease on purpose."""
        if self._kept:
            self.require(owner)

    def _settle(self) -> None:
        if not self._kept and not self._moving:
            self._owner = None
