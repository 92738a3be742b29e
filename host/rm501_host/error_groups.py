"""What a task group ended with, as the one error that the command line tells.

`except*` is not for this: what is raised in it comes out in a group again (before Python 3.11.4 always).
"""

from __future__ import annotations

import asyncio

from rm501_host.errors import Rm501Error


def told_by(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """The first error that we know, else a cancellation. The group itself where anything else is in it: that is an
    error of ours and has to be seen.
    """
    known, unknown = group.split((Rm501Error, asyncio.CancelledError))
    if known is None or unknown is not None:
        return group
    first: BaseException = known.subgroup(Rm501Error) or known
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    return first
