"""Making sure that the board runs the configuration of this host."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rm501_host.errors import RefusedError
from rm501_protocol.board_config import BoardConfig
from rm501_protocol.enums import BoardState
from rm501_protocol.messages import ConfigAccepted, ConfigCommit, Identify, Status

if TYPE_CHECKING:
    from rm501_host.session.board_session import BoardSession


async def agree_on_configuration(
    session: BoardSession, identify: Identify, status: Status, config: BoardConfig
) -> None:
    """Send `config` to a board that has another one; raises RefusedError naming what differs when it may not be
    configured now, or takes something else.
    """
    if identify.config_hash == config.hash:
        return
    if status.state not in (BoardState.BOOT, BoardState.IDLE):
        raise RefusedError(
            f"the board is {status.state.name} with another configuration ({_differing(identify, config)}); "
            "stop and reset it, then connect again"
        )
    for page in config.pages():
        session.post(page)
    accepted = await session.request(ConfigCommit(config.hash), ConfigAccepted)
    if accepted.config_hash != config.hash:
        raise RefusedError(
            f"the board took configuration {accepted.config_hash:08x} instead of {config.hash:08x}; reset the board"
        )


def _differing(identify: Identify, config: BoardConfig) -> str:
    found = [f"configuration {identify.config_hash:08x} instead of {config.hash:08x}"]
    if identify.base_period_us != config.timing.base_period_us:
        found.append(f"base period {identify.base_period_us} us instead of {config.timing.base_period_us} us")
    if identify.frame_periods != config.frame_periods:
        found.append(f"frame of {identify.frame_periods} periods instead of {config.frame_periods}")
    return ", ".join(found)
