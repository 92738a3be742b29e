"""The dispatcher: JSON-RPC's own rules, limits, and random calls that never crash it nor move a machine in ESTOP."""

from __future__ import annotations

import asyncio
import json
import random
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from rm501_host.daemon.access import Access
from rm501_host.daemon.documents import api_document
from rm501_host.daemon.methods import api
from rm501_host.daemon.rpc import MAX_BODY_BYTES, Code, Dispatcher
from rm501_host.daemon.service import Client, Service
from rm501_host.machine import MachineState
from rm501_host.virtual_time import run_virtual
from tests.support.rpc_fuzz import random_call
from tests.support.virtual_machine import REPOSITORY, running_service


def client_of(service: Service, access: Access = Access.FULL) -> tuple[Client, Dispatcher[Client]]:
    return service.connect("test", access, lambda message: None, lambda: 0), Dispatcher(api)


async def ask(dispatcher: Dispatcher[Client], client: Client, body: object) -> Any:
    raw = body if isinstance(body, bytes) else json.dumps(body).encode()
    answer = await dispatcher.answer(raw, client)
    return None if answer is None else json.loads(answer)


def request(method: str, **params: object) -> dict[str, object]:
    return {"jsonrpc": "2.0", "id": 7, "method": method, "params": params}


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"{", Code.PARSE_ERROR),
        (b"\xff\xfe", Code.PARSE_ERROR),
        (b"[1,", Code.PARSE_ERROR),
        (b"[]", Code.INVALID_REQUEST),
        (b"1", Code.INVALID_REQUEST),
        ({"id": 1, "method": "status"}, Code.INVALID_REQUEST),
        ({"jsonrpc": "1.0", "id": 1, "method": "status"}, Code.INVALID_REQUEST),
        ({"jsonrpc": "2.0", "id": 1, "method": 5}, Code.INVALID_REQUEST),
        ({"jsonrpc": "2.0", "id": [], "method": "status"}, Code.INVALID_REQUEST),
        (b'{"jsonrpc":"2.0","id":1,"method":"status","params":' + b"[" * 100 + b"]" * 100 + b"}", Code.INVALID_REQUEST),
        (b'"' + b"a" * MAX_BODY_BYTES + b'"', Code.INVALID_REQUEST),
        (request("nothing"), Code.METHOD_NOT_FOUND),
        (request("__class__"), Code.METHOD_NOT_FOUND),
        (request("status", extra=1), Code.INVALID_PARAMS),
        (request("override", ratio="1"), Code.INVALID_PARAMS),
        (request("override", ratio=2.01), Code.INVALID_PARAMS),
        (request("hand", action="crush"), Code.INVALID_PARAMS),
        ({"jsonrpc": "2.0", "id": 1, "method": "status", "params": [1]}, Code.INVALID_PARAMS),
        (request("home"), Code.REFUSED),
    ],
)
def test_wrong_requests_get_the_right_code(tmp_path: Path, body: object, code: Code) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            client, dispatcher = client_of(service)
            answer = await ask(dispatcher, client, body)
            assert answer["jsonrpc"] == "2.0" and answer["error"]["code"] == code and answer["error"]["message"]
            assert service.machine.state is MachineState.ESTOP

    run_virtual(scenario())


def test_batches_and_notifications(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            client, dispatcher = client_of(service)
            answers = await ask(dispatcher, client, [request("version"), request("nothing"), 5])
            assert [("error" in answer) for answer in answers] == [False, True, True]
            quiet = {"jsonrpc": "2.0", "method": "version"}
            assert await ask(dispatcher, client, quiet) is None
            assert await ask(dispatcher, client, [quiet, quiet]) is None
            too_many = await ask(dispatcher, client, [request("version")] * 17)
            assert too_many["error"]["code"] == Code.INVALID_REQUEST

    run_virtual(scenario())


def test_access_levels_hold_for_every_method(tmp_path: Path) -> None:
    """Whoever has a lower level than a method needs gets UNAUTHORIZED, whatever the parameters, and changes nothing."""

    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            before = service.status()
            for level in (Access.STOP, Access.READ):
                client, dispatcher = client_of(service, level)
                for method in api:
                    if method.access <= level:
                        continue
                    for params in ({}, {"name": "x"}, {"fault": None}, [], 5):
                        body = {"jsonrpc": "2.0", "id": 1, "method": method.name, "params": params}
                        answer = await ask(dispatcher, client, body)
                        assert answer["error"]["code"] in (Code.UNAUTHORIZED, Code.RATE_LIMITED), method.name
                    await asyncio.sleep(0.1)
            after = service.status()
            assert (after.task_state, after.steps, after.owner) == (before.task_state, before.steps, before.owner)
            assert [method.name for method in api if method.access is Access.STOP] == [
                "version",
                "hello",
                "stop",
                "kill",
                "hold",
            ]

    run_virtual(scenario())


@pytest.mark.parametrize(("method", "key"), [("hold", "held"), ("abort", "ended")])
def test_nothing_to_hold_or_abort_is_told(tmp_path: Path, method: str, key: str) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            client, dispatcher = client_of(service)
            for state in (MachineState.ESTOP, MachineState.IDLE):
                assert service.machine.state is state
                assert (await ask(dispatcher, client, request(method)))["result"] == {key: False}
                await ask(dispatcher, client, request("reset"))

    run_virtual(scenario())


def test_override_and_running_back_by_rpc(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            (tmp_path / "programs").mkdir(exist_ok=True)
            (tmp_path / "programs" / "a.ngc").write_text("G21 G90 G94\nM102\nG1 X210 Y60 Z-150 F1500\nM2\n")
            client, dispatcher = client_of(service)

            async def call(method: str, **params: object) -> Any:
                answer = await ask(dispatcher, client, request(method, **params))
                return answer.get("result", answer.get("error"))

            await call("reset")
            await call("motion.wait", **await call("home"))
            await call("motion.wait", **await call("mdi", block="G0 X210 Y0 Z-150 A0 B0 C0"))
            assert "no program is under way" in (await call("program.back", seconds=1))["message"]
            for seconds in (0, -1, 30.5, "1", None):
                assert (await call("program.back", seconds=seconds))["code"] == Code.INVALID_PARAMS
            run = await call("program.run", name="a.ngc")
            await asyncio.sleep(3.0)
            assert await call("override", ratio=1.5) is None
            assert (await call("status"))["override"] == 1.5
            assert await call("hold") == {"held": True}
            while (await call("status"))["run_state"] != "HELD":  # noqa: ASYNC110  # polled from outside
                await asyncio.sleep(0.1)
            way = await call("program.back", seconds=30)
            assert way["repeats"] == ["hand closes (line 2)"]
            assert 1.5 < way["seconds"] < 3.5
            while (await call("status"))["waiting"] != "run back":  # noqa: ASYNC110  # polled from outside
                await asyncio.sleep(0.1)
            assert "going forward repeats: hand closes (line 2)" in (await call("status"))["messages"][-1]
            assert await call("resume") is None
            await call("motion.wait", **run)

    run_virtual(scenario())


def test_a_flood_is_limited_but_never_a_stop(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            client, dispatcher = client_of(service)
            codes = [
                (await ask(dispatcher, client, request("version"))).get("error", {}).get("code") for _ in range(600)
            ]
            assert codes.count(Code.RATE_LIMITED) == 200
            for _ in range(100):
                assert "error" not in await ask(dispatcher, client, request("hold"))
            await asyncio.sleep(1.0)
            assert "error" not in await ask(dispatcher, client, request("version"))

    run_virtual(scenario())


def test_random_calls_never_crash_the_daemon(tmp_path: Path) -> None:
    """3,000 calls here; `python -m benchmarks.daemon --fuzz 1e5` makes 100,000."""

    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            client, dispatcher = client_of(service)
            source = random.Random(3)
            for number in range(3000):
                body = random_call(source, frozenset({"motion.wait"}))
                answer = await dispatcher.answer(body, client)
                if answer is not None:
                    decoded = json.loads(answer)
                    for one in decoded if isinstance(decoded, list) else [decoded]:
                        assert one.get("error", {}).get("code") != Code.INTERNAL_ERROR, (number, body, one)
                await asyncio.sleep(0.01)
            assert service.status().connected

    run_virtual(scenario())
    assert all("passwd" not in path.name for path in tmp_path.rglob("*"))


def test_subscription_sends_differences_that_add_up(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            sent: list[dict[str, Any]] = []
            client = service.connect("test", Access.FULL, lambda body: sent.append(json.loads(body)), lambda: 0)
            dispatcher: Dispatcher[Client] = Dispatcher(api)
            first = (await ask(dispatcher, client, request("subscribe", period_ms=20)))["result"]
            await ask(dispatcher, client, request("reset"))
            await ask(dispatcher, client, request("home"))
            await asyncio.sleep(5)
            seen = dict(first)
            for message in sent:
                assert message["method"] == "status"
                seen.update(message["params"])
            now = (await ask(dispatcher, client, request("status")))["result"]
            for moving in ("time_s", "joints_deg", "steps", "queue_lead_s", "rate", "queue_used"):
                seen.pop(moving), now.pop(moving)
            assert seen == now
            assert 50 < len(sent) <= 251
            times = [message["params"]["time_s"] for message in sent]
            assert min(b - a for a, b in pairwise(times)) > 0.0199

    run_virtual(scenario())


def test_who_watches_at_fifty_hertz_sees_a_change_every_time(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with running_service(tmp_path) as service:
            sent: list[dict[str, Any]] = []
            client = service.connect("test", Access.FULL, lambda body: sent.append(json.loads(body)), lambda: 0)
            slow = service.connect("slow", Access.READ, lambda body: None, lambda: 0)
            dispatcher: Dispatcher[Client] = Dispatcher(api)
            await ask(dispatcher, client, request("reset"))

            async def moved(seconds: float) -> int:
                """In how many messages of so many seconds the steps had changed."""
                sent.clear()
                await asyncio.sleep(seconds)
                return sum("steps" in message["params"] for message in sent)

            await ask(dispatcher, client, request("home", joints=["waist"]))
            await ask(dispatcher, slow, request("subscribe", period_ms=1000))
            await asyncio.sleep(2.0)
            await ask(dispatcher, client, request("subscribe", period_ms=20))
            assert await moved(2.0) >= 90
            # the quickest subscriber decides how often the board tells
            await ask(dispatcher, client, request("subscribe", period_ms=100))
            assert 18 <= await moved(2.0) <= 20
            service.disconnect(client)
            assert not client.is_subscribed and slow.is_subscribed

    run_virtual(scenario())


def test_the_documentation_is_what_runs() -> None:
    assert (REPOSITORY / "docs" / "api.md").read_text("utf-8") == api_document(), (
        "run `python -m rm501_host.daemon.documents docs`"
    )
