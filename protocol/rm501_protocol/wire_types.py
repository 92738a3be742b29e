"""The types that fields of messages have on the wire, all little endian.

A message declares a field once, as ``name: Annotated[int, U32("frames", "what it means")]``; encoder, decoder,
documentation and test vectors are derived from that. Wire types are values: they know width, range, unit and meaning,
and how to turn one Python value into bytes and back. `declaration` strings them together.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, ClassVar

__all__ = ["S8", "S16", "S32", "S80", "U8", "U16", "U32", "Bool", "Record", "Scalar", "Text", "Vector", "WireType"]


class WireType:
    """One field's type on the wire: `encode` appends to a buffer, `decode` reads at an offset and returns the next
    one.
    """

    __slots__ = ()
    unit: str
    doc: str

    @property
    def wire_name(self) -> str:
        """Name used in the documentation."""
        return type(self).__name__.lower()

    def encode(self, value: Any, out: bytearray) -> None:
        """Append `value`; raises ValueError when it does not fit."""
        raise NotImplementedError

    def decode(self, data: bytes, offset: int) -> tuple[Any, int]:
        """Read one value at `offset`; raises ValueError when the bytes end early or mean nothing."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Scalar(WireType):
    """An integer of fixed width, two's complement where signed."""

    unit: str = ""
    doc: str = ""

    SIZE: ClassVar[int]
    SIGNED: ClassVar[bool]
    FORMAT: ClassVar[str]  # struct format character, empty where struct has none
    PACKS: ClassVar[bool] = True  # whether struct's own range check is the right one

    @property
    def minimum(self) -> int:
        """Smallest value that fits."""
        return -(1 << (8 * self.SIZE - 1)) if self.SIGNED else 0

    @property
    def maximum(self) -> int:
        """Largest value that fits."""
        return (1 << (8 * self.SIZE - int(self.SIGNED))) - 1

    def encode(self, value: Any, out: bytearray) -> None:
        """Append the integer."""
        if not isinstance(value, int):
            raise ValueError(f"an integer {self.minimum}..{self.maximum}")
        try:
            out += value.to_bytes(self.SIZE, "little", signed=self.SIGNED)
        except OverflowError:
            raise ValueError(f"{self.minimum}..{self.maximum}") from None

    def decode(self, data: bytes, offset: int) -> tuple[Any, int]:
        """Read the integer."""
        end = offset + self.SIZE
        if end > len(data):
            raise ValueError("the payload ends early")
        return int.from_bytes(data[offset:end], "little", signed=self.SIGNED), end


class U8(Scalar):
    """Unsigned, 1 byte."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 1, False, "B"


class U16(Scalar):
    """Unsigned, 2 bytes."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 2, False, "H"


class U32(Scalar):
    """Unsigned, 4 bytes."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 4, False, "I"


class S8(Scalar):
    """Signed, 1 byte."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 1, True, "b"


class S16(Scalar):
    """Signed, 2 bytes."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 2, True, "h"


class S32(Scalar):
    """Signed, 4 bytes."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 4, True, "i"


class S80(Scalar):
    """Signed, 10 bytes: 32 bits of whole steps and 48 bits of fraction."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 10, True, ""
    PACKS = False


class Bool(Scalar):
    """One byte, 0 or 1; any other value is malformed."""

    __slots__ = ()
    SIZE, SIGNED, FORMAT = 1, False, "B"
    PACKS = False

    @property
    def maximum(self) -> int:
        """Largest value that fits."""
        return 1

    def encode(self, value: Any, out: bytearray) -> None:
        """Append 0 or 1."""
        if value not in (False, True):
            raise ValueError("False or True")
        out.append(int(value))

    def decode(self, data: bytes, offset: int) -> tuple[Any, int]:
        """Read 0 or 1."""
        if offset >= len(data):
            raise ValueError("the payload ends early")
        if data[offset] > 1:
            raise ValueError(f"{data[offset]} is neither 0 nor 1")
        return data[offset] == 1, offset + 1


@dataclass(frozen=True, slots=True)
class Vector(WireType):
    """Up to `cap` elements of one type, their count in a byte before them."""

    element: WireType
    cap: int
    unit: str = ""
    doc: str = ""

    @property
    def wire_name(self) -> str:
        """Name used in the documentation."""
        return f"u8 count, then count x {self.element.wire_name} (at most {self.cap})"

    def encode(self, value: Any, out: bytearray) -> None:
        """Append count and elements."""
        count = len(value)
        if count > self.cap:
            raise ValueError(f"at most {self.cap} elements")
        out.append(count)
        element = self.element
        if isinstance(element, Scalar) and element.PACKS:
            try:
                out += struct.pack(f"<{count}{element.FORMAT}", *value)
            except struct.error:
                raise ValueError(f"elements {element.minimum}..{element.maximum}") from None
            return
        for item in value:
            element.encode(item, out)

    def decode(self, data: bytes, offset: int) -> tuple[Any, int]:
        """Read count and elements into a tuple."""
        if offset >= len(data):
            raise ValueError("the payload ends early")
        count = data[offset]
        if count > self.cap:
            raise ValueError(f"{count} elements, at most {self.cap} allowed")
        offset += 1
        element = self.element
        if isinstance(element, Scalar) and element.PACKS:
            end = offset + count * element.SIZE
            if end > len(data):
                raise ValueError("the payload ends early")
            return struct.unpack_from(f"<{count}{element.FORMAT}", data, offset), end
        items = []
        for _ in range(count):
            item, offset = element.decode(data, offset)
            items.append(item)
        return tuple(items), offset


@dataclass(frozen=True, slots=True)
class Record(WireType):
    """A small frozen dataclass inside a message, its scalar fields one after the other."""

    cls: type
    fields: tuple[tuple[str, Scalar], ...]
    unit: str = ""
    doc: str = ""

    @property
    def wire_name(self) -> str:
        """Name used in the documentation."""
        return "(" + ", ".join(f"{name} {wire.wire_name}" for name, wire in self.fields) + ")"

    def encode(self, value: Any, out: bytearray) -> None:
        """Append the fields of `value`."""
        for name, wire in self.fields:
            try:
                wire.encode(getattr(value, name), out)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None

    def decode(self, data: bytes, offset: int) -> tuple[Any, int]:
        """Read the fields and build the dataclass."""
        values = []
        for _, wire in self.fields:
            item, offset = wire.decode(data, offset)
            values.append(item)
        return self.cls(*values), offset


@dataclass(frozen=True, slots=True)
class Text(WireType):
    """UTF-8 text of at most `cap` bytes, its length in a byte before it."""

    cap: int
    unit: str = ""
    doc: str = ""

    @property
    def wire_name(self) -> str:
        """Name used in the documentation."""
        return f"u8 length, then UTF-8 (at most {self.cap} bytes)"

    def encode(self, value: Any, out: bytearray) -> None:
        """Append length and text."""
        raw = str(value).encode()
        if len(raw) > self.cap:
            raise ValueError(f"at most {self.cap} bytes of UTF-8")
        out.append(len(raw))
        out += raw

    def decode(self, data: bytes, offset: int) -> tuple[Any, int]:
        """Read length and text."""
        if offset >= len(data):
            raise ValueError("the payload ends early")
        count = data[offset]
        end = offset + 1 + count
        if count > self.cap or end > len(data):
            raise ValueError("text longer than allowed or than the payload")
        try:
            return data[offset + 1 : end].decode(), end
        except UnicodeDecodeError:
            raise ValueError("text is not UTF-8") from None
