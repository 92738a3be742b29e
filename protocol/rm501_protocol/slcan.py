"""The text format of serial-line CAN adapters (Lawicel's "slcan", with the usual letters for CAN FD), sans-IO.

::

    tIIILDD..\\r    standard frame: identifier (3 hex digits), length (1), data bytes (2 each)
    dIIILDD..\\r    the same as CAN FD, L is the length code 0..F;  b: with bit rate switch
    C O L Sn sn Yn V N F, each \\r     commands to the adapter, answered \\r (done) or \\a (refused)

`SlcanAdapter` is the adapter's side: what it answers to a host, and the frames that the host sends.
"""

from __future__ import annotations

from .can_transfer import CanFrame

__all__ = ["LINE_CAP", "SlcanAdapter", "SlcanDecoder", "encode_frame", "parse_frame"]

LINE_CAP = 1 + 8 + 1 + 2 * 64 + 4 + 1
"""Longest line: an extended FD frame with a time stamp."""
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_DONE, _REFUSED = b"\r", b"\a"


def encode_frame(frame: CanFrame) -> bytes:
    """One line; frames longer than 8 bytes become CAN FD. Raises ValueError for an impossible identifier or length."""
    if not 0 <= frame.can_id <= 0x7FF:
        raise ValueError(f"identifier 0x{frame.can_id:x} is not 11 bits")
    if len(frame.data) not in _FD_LENGTHS:
        raise ValueError(f"no CAN frame has {len(frame.data)} bytes")
    letter = "t" if len(frame.data) <= 8 else "d"
    code = _FD_LENGTHS.index(len(frame.data))
    return f"{letter}{frame.can_id:03X}{code:X}{frame.data.hex().upper()}".encode() + _DONE


def parse_frame(line: bytes) -> CanFrame | None:
    """The frame in a line without its end; None when it is none, or one with an extended identifier. Time stamps are
    ignored.
    """
    if line[:1] not in (b"t", b"d", b"b"):
        return None
    try:
        text = line.decode("ascii")
        if not all(digit in "0123456789abcdefABCDEF" for digit in text[1:]):
            return None
        identifier, code = int(text[1:4], 16), int(text[4:5], 16)
        size = _FD_LENGTHS[code]
        data = bytes.fromhex(text[5 : 5 + 2 * size])
    except ValueError:
        return None
    if identifier > 0x7FF or len(data) != size or (text[0] == "t" and size > 8):
        return None
    if len(text) - 5 - 2 * size not in (0, 4):
        return None
    return CanFrame(identifier, data)


class SlcanDecoder:
    """Cuts a stream into lines; holds at most `LINE_CAP` bytes."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._skipping = False
        self.bad_lines = 0
        """Lines longer than any frame."""

    def feed(self, data: bytes) -> list[bytes]:
        """Lines without their end that `data` completes; a lone refusal (BEL) comes as itself."""
        lines = []
        for value in data:
            if value in (0x0D, 0x07):
                if self._skipping:
                    self._skipping = False
                else:
                    if self._buffer or value == 0x0D:
                        lines.append(bytes(self._buffer))
                    if value == 0x07:
                        lines.append(_REFUSED)
                self._buffer.clear()
            elif not self._skipping:
                self._buffer.append(value)
                if len(self._buffer) > LINE_CAP:
                    self._buffer.clear()
                    self._skipping = True
                    self.bad_lines += 1
        return lines


class SlcanAdapter:
    """An adapter as a host sees it: commands answered, frames accepted while the channel is open."""

    def __init__(self) -> None:
        self._decoder = SlcanDecoder()
        self._replies = bytearray()
        self.is_open = False
        """Whether the host opened the channel."""

    def receive(self, data: bytes) -> list[CanFrame]:
        """Frames that the host puts on the bus; what to answer is fetched with `replies`."""
        frames = []
        for line in self._decoder.feed(data):
            frame = parse_frame(line)
            if frame is not None and self.is_open:
                frames.append(frame)
                self._replies += b"z" + _DONE
            else:
                self._replies += self._command(line)
        return frames

    def replies(self) -> bytes:
        """Answers since the last call."""
        out = bytes(self._replies)
        self._replies.clear()
        return out

    def transmit(self, frame: CanFrame) -> bytes:
        """The line that shows a frame from the bus to the host; empty while the channel is closed."""
        return encode_frame(frame) if self.is_open else b""

    def _command(self, line: bytes) -> bytes:
        match line[:1]:
            case b"":
                return _DONE
            case b"O" | b"L":
                self.is_open = True
                return _DONE
            case b"C":
                self.is_open = False
                return _DONE
            case b"S" | b"s" | b"Y" | b"Z" | b"M" | b"m":
                return _DONE
            case b"V":
                return b"V1013" + _DONE
            case b"N":
                return b"N0501" + _DONE
            case b"F":
                return b"F00" + _DONE
            case _:
                return _REFUSED
