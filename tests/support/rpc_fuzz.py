"""Random calls of the daemon's methods: right and wrong types, edges, garbage; seeded."""

from __future__ import annotations

import json
import random
from typing import Any

import msgspec

from rm501_host.daemon.methods import api

_STRINGS = [
    "",
    "x",
    "joint",
    "world",
    "../../etc/passwd",
    "\0",
    "a" * 300,
    "ü€𐍈",
    "waist",
    "open",
    "G1 X5",
    "$(reboot)",
]
_NUMBERS = [0, 1, -1, 0.5, 1e308, -1e308, 2**63, -(2**63), 1e-320, 3, 20, 1000, True, None]


def any_value(source: random.Random, depth: int = 0) -> Any:
    kind = source.randrange(8 if depth < 3 else 5)
    if kind < 2:
        return source.choice(_STRINGS)
    if kind < 5:
        return source.choice(_NUMBERS)
    if kind < 7:
        return [any_value(source, depth + 1) for _ in range(source.randrange(7))]
    return {source.choice(_STRINGS): any_value(source, depth + 1) for _ in range(source.randrange(4))}


def fitting_value(source: random.Random, schema: dict[str, Any]) -> Any:
    if "anyOf" in schema:
        return fitting_value(source, source.choice(schema["anyOf"]))
    if "enum" in schema:
        return source.choice(schema["enum"])
    low = schema.get("minimum", schema.get("exclusiveMinimum", -10))
    high = schema.get("maximum", schema.get("exclusiveMaximum", 10))
    match schema.get("type"):
        case "integer":
            return source.randint(int(low), min(int(high), int(low) + 50))
        case "number":
            return source.uniform(low, high)
        case "boolean":
            return source.random() < 0.5
        case "string":
            return source.choice(_STRINGS)
        case "array":
            count = max(schema.get("minItems", 0), source.randrange(3))
            items = schema.get("items") or (schema.get("prefixItems") or [{"type": "string"}])[0]
            return [fitting_value(source, items if isinstance(items, dict) else {}) for _ in range(count)]
        case _:
            return None


def random_call(source: random.Random, exclude: frozenset[str] = frozenset()) -> bytes:
    """One message: mostly a call of a real method with parameters that fit, nearly fit or do not fit."""
    dice = source.random()
    if dice < 0.05:
        return bytes(source.randrange(256) for _ in range(source.randrange(80))).replace(b"\n", b" ")
    if dice < 0.1:
        return json.dumps(any_value(source)).encode()
    method = source.choice([method for method in api if method.name not in exclude])
    params: Any = {}
    for field in msgspec.structs.fields(method.params):
        if source.random() < 0.1:
            continue
        fits = source.random() < 0.75
        schema = msgspec.json.schema(field.type)
        params[field.encode_name] = fitting_value(source, schema) if fits else any_value(source)
    if source.random() < 0.05:
        params[source.choice(_STRINGS)] = any_value(source)
    if source.random() < 0.05:
        params = any_value(source)
    name = method.name if source.random() < 0.95 else source.choice(_STRINGS)
    message: dict[str, Any] = {
        "jsonrpc": "2.0",
        "id": source.choice([1, "a", None, 2.5]),
        "method": name,
        "params": params,
    }
    if source.random() < 0.05:
        message.pop(source.choice(list(message)))
    body = json.dumps(message).encode()
    if source.random() < 0.03:
        body = body[: source.randrange(len(body))]
    return body
