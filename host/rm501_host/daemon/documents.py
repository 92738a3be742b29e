"""`python -m rm501_host.daemon.documents DOCS`: write docs/api.md, and the diagram into docs/operating.md.

Both are made from what runs: the declared methods, the error codes, the transition table. A test compares.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

import msgspec

from rm501_host.daemon.methods import api
from rm501_host.daemon.rpc import API_VERSION, CODE_TEXTS, MAX_BATCH, MAX_BODY_BYTES, NoParams
from rm501_host.machine.states import mermaid_diagram
from rm501_host.machine.status import MachineStatus

_DIAGRAM = re.compile(r"(?<=<!-- states -->\n```mermaid\n).*?(?=\n```)", re.DOTALL)
_FIELD_DOC = re.compile(r'^    (\w+):.*\n(?:    """(.*?)""")?', re.MULTILINE)

_INTRODUCTION = f"""# The daemon's interface

JSON-RPC 2.0, version {API_VERSION} of this interface.
Made from the declarations in `rm501_host.daemon.methods`; do not edit.

- Unix socket: one message a line. Its file mode (0660) decides who may use it; such clients may do everything.
- WebSocket: `ws://HOST:PORT/rpc`, one message a text frame. On loopback without `--token-file` local clients may do
  everything. With one, `Authorization: Bearer TOKEN` is needed; a local client without it may call the methods of
  access STOP only, any other is refused with 401. A wrong token is 401, a foreign `Origin` or `Host` 403.
- A message is at most {MAX_BODY_BYTES} bytes, a batch at most {MAX_BATCH} requests; 200 calls a second a client on the
  long run, 400 at once. STOP, KILL and HOLD are never limited.
- Unknown parameters are refused. Methods that move the arm answer at once with `{{"motion": number}}`;
  `motion.wait` waits for the end.
- After `subscribe` come notifications `{{"method": "status", "params": {{changed fields}}}}`.

Try it: `echo '{{"jsonrpc":"2.0","id":1,"method":"status"}}' | nc -U $XDG_RUNTIME_DIR/rm501.sock`
"""


def api_document() -> str:
    """The text of docs/api.md."""
    lines = [_INTRODUCTION, "## Error codes\n", "| code | name | meaning |", "|---|---|---|"]
    lines += [f"| {int(code)} | {code.name} | {text} |" for code, text in CODE_TEXTS.items()]
    lines += ["\nOur own errors carry `data.kind`, the class of the error.\n", "## Methods\n"]
    for method in api:
        lines += [
            f"### `{method.name}`\n",
            f"{method.summary} Access: {method.access.name}. Result: `{method.result}`.\n",
        ]
        if method.params is not NoParams:
            lines += [
                f"{inspect.cleandoc(method.params.__doc__ or '')}\n",
                "| parameter | type | default |",
                "|---|---|---|",
            ]
            for field in msgspec.structs.fields(method.params):
                default = "required" if field.required else f"`{_json(_default(field))}`"
                lines.append(f"| {field.encode_name} | {_type(field.type)} | {default} |")
            lines.append("")
    lines += ["## Status\n", "| field | type | meaning |", "|---|---|---|"]
    docs = {name: " ".join((doc or "").split()) for name, doc in _FIELD_DOC.findall(inspect.getsource(MachineStatus))}
    for field in msgspec.structs.fields(MachineStatus):
        lines.append(f"| {field.encode_name} | {_type(field.type)} | {docs.get(field.name, '')} |")
    return "\n".join(lines) + "\n"


def with_diagram(text: str) -> str:
    """`docs/operating.md` with the present diagram."""
    return _DIAGRAM.sub(lambda _: mermaid_diagram(), text)


def _default(field: msgspec.structs.FieldInfo) -> object:
    made = field.default_factory
    return field.default if made is msgspec.NODEFAULT else made()


def _json(value: object) -> str:
    return msgspec.json.encode(value).decode()


def _type(kind: object) -> str:
    """A type as JSON Schema has it, in few words."""
    schema = msgspec.json.schema(kind)
    return _words(schema).replace("|", "\\|")


def _words(schema: dict[str, object]) -> str:
    if "anyOf" in schema:
        parts = schema["anyOf"]
        assert isinstance(parts, list)
        return " or ".join(_words(part) for part in parts)
    if "enum" in schema:
        values = schema["enum"]
        assert isinstance(values, list)
        return ", ".join(map(str, values))
    words = str(schema.get("type", "any"))
    limits = {
        "minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<", "minLength": "length >=",
        "maxLength": "length <=", "minItems": "items >=", "maxItems": "items <=",
    }  # fmt: skip
    found = [f"{sign} {schema[key]}" for key, sign in limits.items() if key in schema]
    return words + (f" ({', '.join(found)})" if found else "")


def main(folder: Path) -> None:
    """Write both documents."""
    (folder / "api.md").write_text(api_document(), "utf-8")
    operating = folder / "operating.md"
    operating.write_text(with_diagram(operating.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs"))
