"""How a message is declared, and the encoder and decoder that follow from the declaration.

`@message(id, direction, ...)` over a frozen dataclass registers it. Its fields carry their wire type in `Annotated`;
an enum annotated with an unsigned type travels as its number. Fields may only ever be added at the end, with a
default: a payload of an older peer, ending before such a field, decodes to the default, and bytes beyond the last
known field are ignored.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any, ClassVar, TypeVar, get_args, get_origin, get_type_hints

from .errors import DecodeError, FieldRangeError
from .wire_types import WireType

__all__ = ["Direction", "Field", "Message", "decode_payload", "encode_payload", "fields_of", "message", "registry"]


class Direction(Enum):
    """Who sends a message."""

    TO_BOARD = "host to board"
    TO_HOST = "board to host"
    BOTH = "both ways"


class Message:
    """Base of every message; the class attributes are set by `message`."""

    __slots__ = ()
    ID: ClassVar[int]
    DIRECTION: ClassVar[Direction]
    SEQUENCED: ClassVar[bool]
    URGENT: ClassVar[bool]


@dataclass(frozen=True, slots=True)
class Field:
    """One declared field: its name, wire type, enum class if it has one, and whether a default stands in when it is
    absent.
    """

    name: str
    wire: WireType
    enum: type[IntEnum] | None
    has_default: bool


class CustomPayload:
    """Mixin of the few messages whose payload no flat list of fields describes; `LAYOUT` documents it."""

    __slots__ = ()
    LAYOUT: ClassVar[str]

    def encode_into(self, out: bytearray) -> None:
        """Append the payload; raises FieldRangeError."""
        raise NotImplementedError

    @classmethod
    def decode_from(cls, data: bytes) -> Any:
        """Read the payload; raises ValueError."""
        raise NotImplementedError


_M = TypeVar("_M", bound=type[Message])
_registry: dict[int, type[Message]] = {}
_fields: dict[type[Message], tuple[Field, ...]] = {}


def message(message_id: int, direction: Direction, *, sequenced: bool, urgent: bool = False) -> Callable[[_M], _M]:
    """Register the dataclass below as message `message_id` (1..127).

    `sequenced` ones arrive exactly once and in order; `urgent` ones go ahead of sequenced messages that still wait to
    be sent.
    """

    def register(cls: _M) -> _M:
        if not 1 <= message_id <= 127 or message_id in _registry:
            raise ValueError(f"message id 0x{message_id:02x} of {cls.__name__} is out of range or taken")
        cls.ID, cls.DIRECTION, cls.SEQUENCED, cls.URGENT = message_id, direction, sequenced, urgent
        _registry[message_id] = cls
        return cls

    return register


def registry() -> dict[int, type[Message]]:
    """Every declared message by id, in order of id."""
    return dict(sorted(_registry.items()))


def fields_of(cls: type[Message]) -> tuple[Field, ...]:
    """The declared fields of a message class, in wire order."""
    known = _fields.get(cls)
    if known is not None:
        return known
    hints = get_type_hints(cls, include_extras=True)
    found = []
    for item in dataclasses.fields(cls):  # type: ignore[arg-type]  # every message class is a dataclass
        hint = hints[item.name]
        wires = [extra for extra in get_args(hint)[1:] if isinstance(extra, WireType)]
        if len(wires) != 1:
            raise TypeError(f"{cls.__name__}.{item.name} declares no wire type")
        base = get_args(hint)[0]
        enum = base if get_origin(base) is None and issubclass(base, IntEnum) else None
        has_default = item.default is not dataclasses.MISSING
        found.append(Field(item.name, wires[0], enum, has_default))
    _fields[cls] = tuple(found)
    return _fields[cls]


def encode_payload(value: Message) -> bytes:
    """The payload of `value`; raises FieldRangeError naming message, field, value and range."""
    out = bytearray()
    if isinstance(value, CustomPayload):
        value.encode_into(out)
        return bytes(out)
    cls = type(value)
    for field in fields_of(cls):
        item = getattr(value, field.name)
        try:
            field.wire.encode(item, out)
        except ValueError as error:
            raise FieldRangeError(cls.__name__, field.name, item, str(error)) from None
    return bytes(out)


def decode_payload(message_id: int, data: bytes) -> Message:
    """The message with `message_id` whose payload is `data`; raises DecodeError."""
    cls = _registry.get(message_id)
    if cls is None:
        raise DecodeError(message_id, "unknown message")
    if issubclass(cls, CustomPayload):
        try:
            decoded: Message = cls.decode_from(data)
        except ValueError as error:
            raise DecodeError(message_id, f"{cls.__name__}: {error}") from None
        return decoded
    offset = 0
    values: list[Any] = []
    for field in fields_of(cls):
        if field.has_default and offset == len(data):
            break
        try:
            item, offset = field.wire.decode(data, offset)
            values.append(item if field.enum is None else field.enum(item))
        except ValueError as error:
            raise DecodeError(message_id, f"{cls.__name__}.{field.name}: {error}") from None
    return cls(*values)
