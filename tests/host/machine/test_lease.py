"""One owner of motion: the second one is refused by name; only a lease kept on purpose outlasts the motion."""

from __future__ import annotations

import pytest

from rm501_host.machine import LeaseHeldError, MotionLease, Owner

A, B = Owner(1, "left terminal"), Owner(2, "right terminal")


def test_a_motion_takes_the_lease_for_as_long_as_it_lasts() -> None:
    lease = MotionLease()
    lease.begin_motion(A)
    with pytest.raises(LeaseHeldError, match="left terminal"):
        lease.begin_motion(B)
    lease.require_control(B)
    lease.end_motion()
    lease.begin_motion(B)
    assert lease.owner == B


def test_a_kept_lease_outlasts_motion_and_keeps_others_from_guiding_it() -> None:
    lease = MotionLease()
    lease.take(A)
    lease.begin_motion(A)
    lease.end_motion()
    for refused in (lease.take, lease.begin_motion, lease.require, lease.require_control):
        with pytest.raises(LeaseHeldError):
            refused(B)
    lease.give_back(B)
    assert lease.owner == A
    lease.give_back(A)
    assert lease.owner is None


def test_giving_back_during_a_motion_waits_for_its_end() -> None:
    lease = MotionLease()
    lease.take(A)
    lease.begin_motion(A)
    lease.give_back(A)
    with pytest.raises(LeaseHeldError):
        lease.begin_motion(B)
    lease.end_motion()
    assert lease.owner is None
