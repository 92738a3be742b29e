"""What every group of methods uses: the registry they are declared in, common parameter types and answers."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rm501_host.daemon.rpc import Registry
from rm501_host.daemon.service import Client
from rm501_host.machine.jobs import Job

Name = Annotated[str, Meta(min_length=1, max_length=100)]
Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
MOTION = '{"motion": int}'

api: Registry[Client] = Registry()
"""All methods; the groups declare into it when `rm501_host.daemon.methods` imports them, in its order."""


class Params(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all parameters: unknown fields are refused."""


def started(job: Job) -> dict[str, object]:
    """The answer of a method that moves the arm."""
    return {"motion": job.id}
