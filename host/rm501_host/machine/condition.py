"""What the machine is in, and why: its state, the causes that hold, and their traces in the log and the black box.

The state changes through `apply` only, by the table in `states`.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from rm501_host.blackbox import BlackBox
from rm501_host.machine import causes
from rm501_host.machine.states import Event, MachineState, describe, next_state
from rm501_host.storage import JsonLog
from rm501_protocol.messages import Status


class Condition:
    """State, causes and traces. `board_status` gives the board's newest status, which each change of state records."""

    def __init__(self, log: JsonLog, black_box: BlackBox, board_status: Callable[[], Status | None]) -> None:
        self.state = MachineState.ESTOP
        self.causes = causes.Causes()
        self._log = log
        self._black_box = black_box
        self._board_status = board_status
        self._watcher: Callable[[], None] = lambda: None

    def watch(self, watcher: Callable[[], None]) -> None:
        """Call `watcher` after each event, one that left the state as it was included."""
        self._watcher = watcher

    def apply(self, event: Event) -> None:
        """Something has happened to the machine; raises IllegalTransitionError for what cannot happen now."""
        before = self.state
        self.state = next_state(before, event)
        if self.state is not before:
            self.write_log("state", before=describe(before), after=describe(self.state), event=event.value)
            status = self._board_status()
            if status is not None:
                self._black_box.add("status", msgspec.json.encode(status, enc_hook=str))
        self._watcher()

    def tell(self, cause: causes.Cause, reason: str) -> None:
        """Add what took the machine away, and when it is news keep the last minute of everything as `reason`."""
        if not self.causes.add(cause):
            return
        self.write_log("estop", cause=cause.text, remedy=cause.remedy)
        path = self._black_box.dump(reason)
        if path is not None:
            self.write_log("black_box", path=str(path))

    def write_log(self, kind: str, **data: object) -> None:
        """One record for the log and the black box."""
        self._black_box.add("log", self._log.write(kind, **data).encode().rstrip())
