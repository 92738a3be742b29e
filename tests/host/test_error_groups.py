"""Of a task group's errors the command line tells one; what nobody expects is never hidden behind it."""

from __future__ import annotations

import asyncio

import pytest

from rm501_host.error_groups import told_by
from rm501_host.errors import NoBoardError, RefusedError

BOARD, REFUSED, CANCELLED, BUG = NoBoardError("gone"), RefusedError("no"), asyncio.CancelledError(), KeyError("bug")


@pytest.mark.parametrize(
    ("errors", "told"),
    [
        ([REFUSED], REFUSED),
        ([CANCELLED, BOARD, REFUSED], BOARD),
        ([BaseExceptionGroup("inner", [CANCELLED, BaseExceptionGroup("", [REFUSED])])], REFUSED),
        ([CANCELLED], CANCELLED),
    ],
)
def test_the_first_that_is_known_is_told(errors: list[BaseException], told: BaseException) -> None:
    assert told_by(BaseExceptionGroup("tasks", errors)) is told


@pytest.mark.parametrize("errors", [[BUG], [REFUSED, BUG], [BaseExceptionGroup("inner", [BOARD, BUG])]])
def test_a_group_with_anything_else_stays_whole(errors: list[BaseException]) -> None:
    group = BaseExceptionGroup("tasks", errors)
    assert told_by(group) is group
