"""At least one example of every message, with edge values; used wherever a test needs every message."""

from dataclasses import dataclass

from rm501_protocol.declaration import Message, encode_payload, registry
from rm501_protocol.test_vectors import examples_of


@dataclass(frozen=True)
class Example:
    message: Message

    @property
    def payload(self) -> bytes:
        return encode_payload(self.message)


EXAMPLES: dict[int, tuple[Example, ...]] = {
    message_id: tuple(Example(message) for message in examples_of(cls)) for message_id, cls in registry().items()
}
