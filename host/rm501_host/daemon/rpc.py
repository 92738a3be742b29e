"""JSON-RPC 2.0 without any input or output: declared methods, a dispatcher, error codes.

A method is declared once: name, parameters (a msgspec Struct), result, access, summary. The dispatcher, the check of
types, `docs/api.md` and the security tests all come from that declaration.

    RpcError            answered to the client with its code; data = {kind, remedy...}
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Generic, TypeVar

import msgspec

from rm501_host.daemon.access import Access, Caller
from rm501_host.errors import NoBoardError, Rm501Error, StoppedError

_LOGGER = logging.getLogger(__name__)

API_VERSION = 1
"""Grows when a method or a field goes away or changes its meaning; additions leave it."""
MAX_BODY_BYTES = 64 * 1024
MAX_BATCH = 16
UNLIMITED = frozenset({"stop", "kill", "hold"})
"""Methods that no rate limit stops."""
MAX_DEPTH = 32
"""Nesting of a request: decoding recurses, and no method needs more than three."""

C = TypeVar("C", bound=Caller)
P = TypeVar("P", bound=msgspec.Struct)


class Code(IntEnum):
    """Error codes: JSON-RPC's own, then ours."""

    PARSE_ERROR = -32700
    INVALID_REQUEST = -32600
    METHOD_NOT_FOUND = -32601
    INVALID_PARAMS = -32602
    INTERNAL_ERROR = -32603
    UNAUTHORIZED = -32001
    RATE_LIMITED = -32003
    LEASE_HELD = -32010
    REFUSED = -32011
    STOPPED = -32012
    NO_BOARD = -32013


CODE_TEXTS: dict[Code, str] = {
    Code.PARSE_ERROR: "the text is not JSON",
    Code.INVALID_REQUEST: "not a JSON-RPC 2.0 request, too long, or too deep",
    Code.METHOD_NOT_FOUND: "no such method",
    Code.INVALID_PARAMS: "parameters of another type or range",
    Code.INTERNAL_ERROR: "an error of the daemon; its log has it",
    Code.UNAUTHORIZED: "this client may not call the method: a token is missing",
    Code.RATE_LIMITED: "too many calls; stop is never limited",
    Code.LEASE_HELD: "another client owns the motion",
    Code.REFUSED: "cannot be done now or not at all; nothing moved",
    Code.STOPPED: "motion ended before its time: stop, fault, lost link",
    Code.NO_BOARD: "there is no board",
}


class RpcError(Exception):
    """An error with its code, for the client."""

    def __init__(self, code: Code, message: str, kind: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.kind = kind


class NoParams(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """No parameters."""


@dataclass(frozen=True)
class Method(Generic[C, P]):
    """A declared method."""

    name: str
    params: type[P]
    access: Access
    summary: str
    result: str
    call: Callable[[C, P], Awaitable[object]]


@dataclass
class Registry(Generic[C]):
    """All methods, by name, in the order of their declaration."""

    _methods: dict[str, Method[C, Any]] = field(default_factory=dict)

    def method(
        self, name: str, params: type[P], access: Access, *, result: str = "null"
    ) -> Callable[[Callable[[C, P], Awaitable[object]]], Callable[[C, P], Awaitable[object]]]:
        """Declare the decorated coroutine as a method; its docstring is the summary."""

        def declare(call: Callable[[C, P], Awaitable[object]]) -> Callable[[C, P], Awaitable[object]]:
            if name in self._methods:
                raise ValueError(f"method {name} is declared twice")
            summary = " ".join((call.__doc__ or "").split())
            self._methods[name] = Method(name, params, access, summary, result, call)
            return call

        return declare

    def get(self, name: str) -> Method[C, Any] | None:
        """The method of that name, or None."""
        return self._methods.get(name)

    def __iter__(self) -> Iterator[Method[C, Any]]:
        return iter(self._methods.values())

    def __len__(self) -> int:
        return len(self._methods)


class _Request(msgspec.Struct, frozen=True):
    method: str
    jsonrpc: str = ""
    params: msgspec.Raw = msgspec.Raw(b"{}")
    id: int | float | str | msgspec.UnsetType | None = msgspec.UNSET


class Dispatcher(Generic[C]):
    """Answers requests with the methods of a registry."""

    def __init__(self, registry: Registry[C]) -> None:
        self._registry = registry

    async def answer(self, body: bytes, caller: C) -> bytes | None:
        """The response to a request or a batch; None when there is nothing to answer. Never raises on bad input."""
        if len(body) > MAX_BODY_BYTES:
            return _failed(None, RpcError(Code.INVALID_REQUEST, f"longer than {MAX_BODY_BYTES} bytes"))
        if _too_deep(body):
            return _failed(None, RpcError(Code.INVALID_REQUEST, f"nested deeper than {MAX_DEPTH}"))
        if body.lstrip()[:1] != b"[":
            return await self._one(body, caller)
        try:
            parts = msgspec.json.decode(body, type=list[msgspec.Raw])
        except msgspec.DecodeError as error:
            return _failed(None, RpcError(Code.PARSE_ERROR, str(error)))
        if not 1 <= len(parts) <= MAX_BATCH:
            return _failed(None, RpcError(Code.INVALID_REQUEST, f"a batch has 1 to {MAX_BATCH} requests"))
        answers = [answer for part in parts if (answer := await self._one(bytes(part), caller)) is not None]
        return b"[" + b",".join(answers) + b"]" if answers else None

    async def _one(self, body: bytes, caller: C) -> bytes | None:
        try:
            request = msgspec.json.decode(body, type=_Request)
        except msgspec.ValidationError as error:
            return _failed(None, RpcError(Code.INVALID_REQUEST, str(error)))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            return _failed(None, RpcError(Code.PARSE_ERROR, str(error)))
        if request.jsonrpc != "2.0":
            return _failed(request.id, RpcError(Code.INVALID_REQUEST, 'jsonrpc must be "2.0"'))
        try:
            result = await self._call(request, caller)
        except RpcError as error:
            return _failed(request.id, error)
        if request.id is msgspec.UNSET:
            return None
        return msgspec.json.encode({"jsonrpc": "2.0", "id": request.id, "result": result})

    async def _call(self, request: _Request, caller: C) -> object:
        method = self._registry.get(request.method)
        if request.method not in UNLIMITED and caller.rate_limited():
            raise RpcError(Code.RATE_LIMITED, "too many calls; slow down", "rate")
        if method is None:
            raise RpcError(Code.METHOD_NOT_FOUND, f"there is no method {request.method[:80]!r}", "method")
        if not caller.may(method.access):
            raise RpcError(Code.UNAUTHORIZED, f"{method.name} needs a token; send it as a Bearer token", "token")
        try:
            params = msgspec.json.decode(bytes(request.params) or b"{}", type=method.params)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise RpcError(Code.INVALID_PARAMS, f"{method.name}: {error}", "params") from error
        try:
            return await method.call(caller, params)
        except Rm501Error as error:
            raise RpcError(_code_of(error), str(error), type(error).__name__) from error
        except RpcError:
            raise
        except Exception as error:  # the supervisor's edge: a client must never take the daemon down
            _LOGGER.exception("method %s failed", method.name)
            raise RpcError(Code.INTERNAL_ERROR, f"{method.name} failed; see the daemon's log", "internal") from error


def notification(name: str, params: object) -> bytes:
    """A JSON-RPC notification."""
    return msgspec.json.encode({"jsonrpc": "2.0", "method": name, "params": params})


def error_response(code: Code, message: str) -> bytes:
    """An error that answers no request in particular."""
    return _failed(None, RpcError(code, message))


def _code_of(error: Rm501Error) -> Code:
    from rm501_host.machine.lease import LeaseHeldError

    if isinstance(error, LeaseHeldError):
        return Code.LEASE_HELD
    if isinstance(error, NoBoardError):
        return Code.NO_BOARD
    if isinstance(error, StoppedError):
        return Code.STOPPED
    return Code.REFUSED


def _failed(id_: object, error: RpcError) -> bytes:
    """An error response; a request without an id gets none to refer to."""
    body: dict[str, object] = {"code": int(error.code), "message": error.message}
    if error.kind:
        body["data"] = {"kind": error.kind}
    return msgspec.json.encode({"jsonrpc": "2.0", "id": None if id_ is msgspec.UNSET else id_, "error": body})


def _too_deep(body: bytes) -> bool:
    """Whether brackets outside texts nest deeper than MAX_DEPTH."""
    if body.count(b"[") + body.count(b"{") <= MAX_DEPTH:
        return False
    depth = 0
    inside_text = escaped = False
    for byte in body:
        if inside_text:
            if escaped:
                escaped = False
            elif byte == 0x5C:
                escaped = True
            elif byte == 0x22:
                inside_text = False
        elif byte == 0x22:
            inside_text = True
        elif byte in b"[{":
            depth += 1
            if depth > MAX_DEPTH:
                return True
        elif byte in b"]}":
            depth -= 1
    return False
