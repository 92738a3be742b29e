"""The protocol between host and board: messages, framing, link, segment arithmetic, clock synchronisation.

Sans-IO: nothing here opens a port, reads a clock or needs an event loop. Both ends use the same classes. The names
below are the public ones; every single message is in `rm501_protocol.messages`, every configuration page in
`rm501_protocol.config_pages`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .board_config import RM501_BOARD, BoardConfig, InputId, Motor
    from .board_link import BoardLink
    from .can_transfer import CanFrame, TransferReceiver, TransferSender
    from .clock import ClockEstimator, ClockQuality
    from .declaration import Message, decode_payload, encode_payload
    from .enums import BoardState, HoldCause
    from .errors import (
        ConfigError,
        DecodeError,
        FieldRangeError,
        LinkClosedError,
        LinkFullError,
        LocalProtocolError,
        ProtocolError,
        RemoteProtocolError,
    )
    from .faults import FAULT_TEXTS, REFUSAL_TEXTS, FaultCode, RefusalReason
    from .framing import PacketCodec, StreamCodec
    from .host_link import HostLink
    from .link_events import Event, Received, SessionLost, SessionOpened, StopKind
    from .messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, MotorTerm, Segment, SegmentEvent, SegmentFlag, Status
    from .motion_map import MotionMap
    from .slcan import SlcanAdapter
    from .transport import Receiver, Transport

__all__ = [
    "FAULT_TEXTS",
    "PROTOCOL_MAJOR",
    "PROTOCOL_MINOR",
    "REFUSAL_TEXTS",
    "RM501_BOARD",
    "BoardConfig",
    "BoardLink",
    "BoardState",
    "CanFrame",
    "ClockEstimator",
    "ClockQuality",
    "ConfigError",
    "DecodeError",
    "Event",
    "FaultCode",
    "FieldRangeError",
    "HoldCause",
    "HostLink",
    "InputId",
    "LinkClosedError",
    "LinkFullError",
    "LocalProtocolError",
    "Message",
    "MotionMap",
    "Motor",
    "MotorTerm",
    "PacketCodec",
    "ProtocolError",
    "Received",
    "Receiver",
    "RefusalReason",
    "RemoteProtocolError",
    "Segment",
    "SegmentEvent",
    "SegmentFlag",
    "SessionLost",
    "SessionOpened",
    "SlcanAdapter",
    "Status",
    "StopKind",
    "StreamCodec",
    "TransferReceiver",
    "TransferSender",
    "Transport",
    "decode_payload",
    "encode_payload",
]

_HOMES = {
    "BoardConfig": "board_config",
    "BoardLink": "board_link",
    "BoardState": "enums",
    "CanFrame": "can_transfer",
    "ClockEstimator": "clock",
    "ClockQuality": "clock",
    "ConfigError": "errors",
    "DecodeError": "errors",
    "Event": "link_events",
    "FAULT_TEXTS": "faults",
    "FaultCode": "faults",
    "FieldRangeError": "errors",
    "HoldCause": "enums",
    "HostLink": "host_link",
    "InputId": "board_config",
    "LinkClosedError": "errors",
    "LinkFullError": "errors",
    "LocalProtocolError": "errors",
    "Message": "declaration",
    "MotionMap": "motion_map",
    "Motor": "board_config",
    "MotorTerm": "messages",
    "PROTOCOL_MAJOR": "messages",
    "PROTOCOL_MINOR": "messages",
    "PacketCodec": "framing",
    "ProtocolError": "errors",
    "REFUSAL_TEXTS": "faults",
    "RM501_BOARD": "board_config",
    "Received": "link_events",
    "Receiver": "transport",
    "RefusalReason": "faults",
    "RemoteProtocolError": "errors",
    "Segment": "messages",
    "SegmentEvent": "messages",
    "SegmentFlag": "messages",
    "SessionLost": "link_events",
    "SessionOpened": "link_events",
    "SlcanAdapter": "slcan",
    "Status": "messages",
    "StopKind": "link_events",
    "StreamCodec": "framing",
    "TransferReceiver": "can_transfer",
    "TransferSender": "can_transfer",
    "Transport": "transport",
    "decode_payload": "declaration",
    "encode_payload": "declaration",
}


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{home}"), name)
