"""The generated parts of `docs/protocol.md`: messages, enums, numbers, state diagrams, an example exchange.

``python -m rm501_protocol.documentation docs/protocol.md`` renews them in place, between their markers; a test fails
when they differ.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import Enum, IntEnum
from pathlib import Path
from typing import TypeVar

from . import enums, link_core, messages, send_window
from .board_config import INPUT_LINES, OUTPUT_LINES, RM501_BOARD
from .config_pages import InputRole, OutputSource, SlotSource
from .declaration import CustomPayload, Direction, Message, fields_of, registry
from .faults import FAULT_TEXTS, REFUSAL_TEXTS
from .framing import MAX_PACKET, StreamCodec
from .host_link import CLOCK_PERIOD_US, HELLO_PERIOD_US, SILENCE_US, STOP_PERIOD_US
from .link import BoardLink, HostLink, StopKind
from .link_states import BOARD_TRANSITIONS, HOST_TRANSITIONS, STOP_TRANSITIONS
from .messages import Identify, MotorTerm, Segment, Truncated
from .round_trip import RTO_FIRST_US, RTO_MAX_US, RTO_MIN_US

__all__ = ["SECTIONS", "renew"]

_State = TypeVar("_State", bound=Enum)
_Input = TypeVar("_Input", bound=Enum)
_MARK = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def renew(text: str) -> str:
    """`text` with every generated section made anew; raises KeyError for an unknown section."""
    return _MARK.sub(lambda match: match[1] + SECTIONS[match[2]]() + match[3], text)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _messages() -> str:
    parts = []
    for cls in registry().values():
        way = {Direction.TO_BOARD: "host → board", Direction.TO_HOST: "board → host", Direction.BOTH: "both ways"}
        kind = "sequenced" if cls.SEQUENCED else "not sequenced"
        urgent = ", urgent" if cls.URGENT else ""
        parts.append(
            f"\n#### 0x{cls.ID:02X} {cls.__name__} ({way[cls.DIRECTION]}, {kind}{urgent})\n\n{_summary(cls)}\n\n"
        )
        if issubclass(cls, CustomPayload):
            parts.append(_layout(cls.LAYOUT))
        elif fields_of(cls):
            rows = []
            for field in fields_of(cls):
                enum = f"{field.enum.__name__}: " if field.enum is not None else ""
                default = " (may be absent)" if field.has_default else ""
                rows.append((f"`{field.name}`", field.wire.wire_name, field.wire.unit, enum + field.wire.doc + default))
            parts.append(_table(("field", "type", "unit", "meaning"), rows))
        else:
            parts.append("No payload.\n")
    return "".join(parts)


def _summary(cls: type[Message]) -> str:
    return " ".join((cls.__doc__ or "").split())


def _layout(text: str) -> str:
    block = text.split("::\n", 1)[1].split("\n\nThe arithmetic")[0].strip("\n")
    return "```\n" + "\n".join(line.removeprefix("    ") for line in block.split("\n")) + "\n```\n"


def _enums() -> str:
    parts = []
    shown: list[type[IntEnum]] = [getattr(enums, name) for name in enums.__all__]
    shown += [OutputSource, SlotSource, InputRole]
    for enum in sorted(shown, key=lambda one: one.__name__):
        parts.append((enum.__name__, ", ".join(f"{int(member)} {member.name}" for member in enum)))
    return _table(("enum", "values"), parts)


def _numbers() -> str:
    rows = [
        ("packet, header to checksum", f"{MAX_PACKET} bytes at most"),
        ("window", f"{send_window.WINDOW} packets in flight per direction"),
        ("line time in flight, and handed out ahead", f"{link_core.LINE_AHEAD_US} us"),
        ("retransmission timeout", f"first {RTO_FIRST_US} us, then RFC 6298 within {RTO_MIN_US}..{RTO_MAX_US} us"),
        ("Stop and Kill", f"two copies, then one every {STOP_PERIOD_US} us until answered"),
        ("Hello", f"every {HELLO_PERIOD_US} us until Identify"),
        ("ClockQuery", f"every {CLOCK_PERIOD_US} us while a session is open"),
        ("silence that the host reports", f"{SILENCE_US} us"),
        ("silence after which a moving board holds", f"{RM501_BOARD.link.link_timeout_ms} ms (ConfigLink)"),
        ("events kept for a slow user", f"{link_core.EVENT_CAP}"),
        ("messages that wait at a sender", f"{send_window.PENDING_CAP}"),
        ("protocol version", f"{messages.PROTOCOL_MAJOR}.{messages.PROTOCOL_MINOR}"),
        ("hash of the RM-501's configuration", f"0x{RM501_BOARD.hash:08X}"),
    ]
    return _table(("what", "value"), rows)


def _diagram(transitions: Mapping[tuple[_State, _Input], _State]) -> str:
    lines = ["```mermaid", "stateDiagram-v2"]
    first = next(iter(transitions))[0]
    lines.append(f"    [*] --> {first.value}")
    for (state, happened), target in transitions.items():
        lines.append(f"    {state.value} --> {target.value}: {happened.value.replace(':', ' -')}")
    return "\n".join([*lines, "```"]) + "\n"


def _states() -> str:
    return (
        "The session, at the host:\n\n"
        + _diagram(HOST_TRANSITIONS)
        + "\nThe session, at the board:\n\n"
        + _diagram(BOARD_TRANSITIONS)
        + "\nA stop, at the host (beside the session):\n\n"
        + _diagram(STOP_TRANSITIONS)
    )


def _faults() -> str:
    rows = [(str(int(code)), code.name, text.cause, text.effect, text.remedy) for code, text in FAULT_TEXTS.items()]
    return _table(("code", "name", "cause", "effect", "remedy"), rows)


def _refusals() -> str:
    rows = [
        (str(int(reason)), reason.name, text.cause, text.remedy, text.value, text.limit)
        for reason, text in REFUSAL_TEXTS.items()
    ]
    return _table(("reason", "name", "cause", "remedy", "value", "limit"), rows)


def _pins() -> str:
    rows = [
        (f"{line.port}.{line.pin}", line.name, f"out {line.bit}", "yes" if line.inverted else "no")
        for line in OUTPUT_LINES
    ]
    rows += [
        (f"{line.port}.{line.pin}", line.name, f"in {line.bit}, input {number}", "yes" if line.inverted else "no")
        for number, line in enumerate(INPUT_LINES)
    ]
    return _table(("port.pin", "line", "bit", "active low"), rows)


def _example() -> str:
    """A handshake, a segment of which the first copy is lost, a report, a stop, as both ends really produce them."""
    host, board = HostLink(), BoardLink(0x00C0FFEE, Identify(build="example"))
    board.free_slots = 32
    now_us = 0
    rows: list[tuple[str, ...]] = []

    def carry(sender: HostLink | BoardLink, receiver: HostLink | BoardLink, *, lose: bool = False) -> None:
        for packet in sender.packets_to_send(now_us):
            inner = StreamCodec().feed(packet)[0]
            name = registry()[inner[0]].__name__
            way = "host → board" if sender is host else "board → host"
            rows.append((f"{now_us / 1000:.0f}", way, name + (" (lost)" if lose else ""), f"`{packet.hex(' ')}`"))
            if not lose:
                receiver.receive_data(packet, now_us)
        while receiver.next_event() is not None:
            pass

    host.connect(0x01020304, now_us)
    carry(host, board)
    now_us += 1000
    carry(board, host)
    now_us += 1000
    carry(host, board)
    carry(board, host)
    host.send(Segment(0, 100, (MotorTerm(0, 65536, 256), MotorTerm(2, -65536)), hold_slope=700, stop_slope=1200))
    carry(host, board, lose=True)
    host.send(Segment(100, 50, (MotorTerm(0, 91136),), hold_slope=700, stop_slope=1200))
    now_us += 2000
    carry(host, board)
    now_us += 1000
    carry(board, host)
    now_us += 1000
    carry(host, board)
    board.free_slots = 30
    carry(board, host)
    board.send(Truncated(150))
    carry(board, host)
    carry(host, board)
    now_us += 5000
    host.stop(StopKind.STOP, now_us)
    carry(host, board)
    now_us += 1000
    carry(board, host)
    return _table(("ms", "way", "message", "bytes on the serial line"), rows)


SECTIONS: dict[str, Callable[[], str]] = {
    "messages": _messages,
    "enums": _enums,
    "numbers": _numbers,
    "states": _states,
    "faults": _faults,
    "refusals": _refusals,
    "pins": _pins,
    "example": _example,
}

if __name__ == "__main__":  # pragma: no cover - the command line
    path = Path(sys.argv[1])
    path.write_text(renew(path.read_text(encoding="utf-8")), encoding="utf-8")
