"""How a message is declared, and the encoder and decoder that follow from the declaration.

`@message(id, direction, ...)` over a frozen dataclass registers it. Its fields carry their wire type in `Annotated`;
an enum annotated with an unsigned type travels as its number. Fields may only ever be added at the end, with a
default: a payload of an older peer, ending before such a field, decodes to the default, and bytes beyond the last
known field are ignored.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum
from operator import attrgetter
from typing import Any, ClassVar, TypeVar, get_args, get_origin, get_type_hints

from .errors import DecodeError, FieldRangeError
from .wire_types import Scalar, WireType

__all__ = [
    "CustomPayload",
    "Direction",
    "Field",
    "Message",
    "decode_fieldwise",
    "decode_payload",
    "encode_payload",
    "fields_of",
    "message",
    "misfits",
    "registry",
]


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
_steps: dict[type[Message], tuple[_Step, ...]] = {}


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


class _Step:
    """A stretch of a payload: neighbouring scalars in one struct, or one field of any other type."""

    __slots__ = ("converters", "field", "get", "packed")

    def __init__(self, run: list[Field]) -> None:
        self.field = run[0]
        self.packed: struct.Struct | None = None
        if isinstance(self.field.wire, Scalar) and self.field.wire.PACKS:
            self.packed = struct.Struct("<" + "".join(_scalar(field).FORMAT for field in run))
        names = [field.name for field in run]
        get = attrgetter(*names)
        self.get: Callable[[Any], Any] = get if len(names) > 1 else lambda value: (get(value),)
        self.converters = tuple((place, field.enum) for place, field in enumerate(run) if field.enum is not None)


def _scalar(field: Field) -> Scalar:
    assert isinstance(field.wire, Scalar)
    return field.wire


def _steps_of(cls: type[Message]) -> tuple[_Step, ...]:
    known = _steps.get(cls)
    if known is not None:
        return known
    runs: list[list[Field]] = []
    joinable = False
    for field in fields_of(cls):
        packs = isinstance(field.wire, Scalar) and field.wire.PACKS
        if packs and joinable:
            runs[-1].append(field)
        else:
            runs.append([field])
        joinable = packs
    _steps[cls] = tuple(_Step(run) for run in runs)
    return _steps[cls]


def encode_payload(value: Message) -> bytes:
    """The payload of `value`; raises FieldRangeError naming message, field, value and range."""
    out = bytearray()
    if isinstance(value, CustomPayload):
        value.encode_into(out)
        return bytes(out)
    cls = type(value)
    try:
        for step in _steps_of(cls):
            if step.packed is not None:
                out += step.packed.pack(*step.get(value))
            else:
                step.field.wire.encode(getattr(value, step.field.name), out)
    except (ValueError, struct.error):
        raise next(misfits(value)) from None
    return bytes(out)


def misfits(value: Message) -> Iterator[FieldRangeError]:
    """One error for every field of `value` that does not fit its wire type; nothing for a message that can be sent."""
    for field in fields_of(type(value)):
        item = getattr(value, field.name)
        try:
            field.wire.encode(item, bytearray())
        except ValueError as error:
            yield FieldRangeError(type(value).__name__, field.name, item, str(error))


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
    for step in _steps_of(cls):
        if step.packed is None:
            if step.field.has_default and offset == len(data):
                break
            try:
                item, offset = step.field.wire.decode(data, offset)
            except ValueError as error:
                raise DecodeError(message_id, f"{cls.__name__}.{step.field.name}: {error}") from None
            values.append(item)
            continue
        end = offset + step.packed.size
        if end > len(data):
            return decode_fieldwise(cls, data)
        part = step.packed.unpack_from(data, offset)
        offset = end
        if step.converters:
            items = list(part)
            for place, enum in step.converters:
                try:
                    items[place] = enum(items[place])
                except ValueError as error:
                    raise DecodeError(message_id, f"{cls.__name__}: {error}") from None
            values += items
        else:
            values += part
    return cls(*values)


def decode_fieldwise(cls: type[Message], data: bytes) -> Message:
    """As `decode_payload`, one field after the other; also right for a payload that ends before fields with a
    default.

    Raises DecodeError. Not for messages with a payload of their own.
    """
    offset = 0
    values: list[Any] = []
    for field in fields_of(cls):
        if field.has_default and offset == len(data):
            break
        try:
            item, offset = field.wire.decode(data, offset)
            values.append(item if field.enum is None else field.enum(item))
        except ValueError as error:
            raise DecodeError(cls.ID, f"{cls.__name__}.{field.name}: {error}") from None
    return cls(*values)
