"""One session with one board: bytes in and out, handshake, commands that are confirmed, status.

The session owns the transport and the host's end of the link and runs on callbacks of the event loop alone; it starts
no task. Whatever arrives is given to the listeners first, then to those who wait for it. When the transport is gone
or the board restarted, the session has failed for good: everyone who waits gets the error, and every later call
raises it. What a new session may trust, the board says.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from rm501_host.errors import NoBoardError, RefusedError, Rm501Error, StoppedError
from rm501_host.session.configuring import agree_on_configuration
from rm501_host.session.consistency import Consistency
from rm501_host.session.counters import FrameCounter
from rm501_host.session.errors import ContradictionError, LinkLostError, SessionLostError
from rm501_host.session.refusals import BoardRefusedError
from rm501_host.session.versions import refused_text
from rm501_protocol.board_config import BoardConfig
from rm501_protocol.declaration import Message
from rm501_protocol.framing import PacketCodec
from rm501_protocol.host_link import HostLink
from rm501_protocol.link_events import (
    Event,
    GenerationAdvanced,
    LinkHeard,
    LinkNoisy,
    LinkSilent,
    Received,
    SessionLost,
    SessionOpened,
    SessionRefused,
    StopAcknowledged,
    StopKind,
)
from rm501_protocol.messages import (
    Identify,
    MotionEnded,
    Refused,
    Segment,
    SetPositions,
    Start,
    Status,
    StatusRequest,
)
from rm501_protocol.transport import Transport

M = TypeVar("M", bound=Message)
T = TypeVar("T")
Notice = Message | LinkSilent | LinkHeard | LinkNoisy | SessionLost | StopAcknowledged | GenerationAdvanced
"""What a listener gets: messages of the board and what the link noticed."""
_Heard = Notice | SessionOpened | SessionRefused
WireTap = Callable[[int, str, bytes], None]
"""Called with now_us, "out" or "in", and the bytes."""

HANDSHAKE_TIMEOUT_S = 5.0
"""A board that resets when its port is opened needs about two seconds before it answers."""
COMMAND_TIMEOUT_S = 3.0
"""Far above the longest retransmission (0.25 s) and the longest pause of a board that is alive."""
_STOP_TIMEOUT_S = 2.0
_NOISE_REMEMBERED_S = 30.0
"""A bad line is judged every 500 frames, that is every few seconds at 25 statuses a second."""
STALL_S = 1.0
"""As long as the board waits for its host before it holds and wants a user: link_timeout_ms."""
_JUST_NOW_S = 2.0
"""A command given before a stall has become motion by then: files written, first segments planned."""
_POLL_S = 0.01
"""Between two looks at whether a command took effect."""


class BoardSession:
    """An open session; made by `open_session`."""

    def __init__(self, transport: Transport, nonce: Callable[[], int], wire_tap: WireTap | None = None) -> None:
        self._loop = asyncio.get_running_loop()
        self._transport = transport
        codec = PacketCodec() if transport.packets else None
        self.link = HostLink(codec=codec, bytes_per_second=transport.bytes_per_second)
        self._nonce = nonce
        self._wire_tap = wire_tap
        self._timer: asyncio.TimerHandle | None = None
        self._pump_scheduled = False
        self._waiters: dict[asyncio.Future[Any], Callable[[_Heard], object | None]] = {}
        self._listeners: list[Callable[[Notice], None]] = []
        self._failure: Rm501Error | None = None
        self._closing = False
        self._confirming: list[tuple[Message, asyncio.Future[None]]] = []
        self._data_s: float | None = None
        self._stall_ended_s: float | None = None
        self._stall_s = 0.0
        self._silent_since_s: float | None = None
        self._noise: LinkNoisy | None = None
        self._noise_s = 0.0
        self.motion_frames = FrameCounter()
        self.real_frames = FrameCounter()
        self.status: Status | None = None
        """The newest status, None before the first."""
        self.link_silent = False
        self._consistency: Consistency | None = None
        """Judges what the board reports, once its configuration is known."""

    # ------------------------------------------------------------------------------------------- handshake

    async def handshake(self, board_config: BoardConfig) -> Identify:
        """Open a session and make sure that the board runs `board_config`.

        Raises NoBoardError when nobody answers, RefusedError naming what differs when the board may not be configured
        now.
        """

        def answers(notice: _Heard) -> SessionOpened | SessionRefused | None:
            return notice if isinstance(notice, SessionOpened | SessionRefused) else None

        self._transport.start(self)
        answered: asyncio.Future[SessionOpened | SessionRefused] = self._expect(answers)
        self.link.connect(self._nonce(), self._now_us())
        self._schedule_pump()
        try:
            async with asyncio.timeout(HANDSHAKE_TIMEOUT_S):
                answer = await answered
        except TimeoutError:
            remedy = "check the cable, the board's power and the baud rate, and that nobody else has the port open"
            raise NoBoardError(f"no board answers within {HANDSHAKE_TIMEOUT_S:.0f} s; {remedy}") from None
        if isinstance(answer, SessionRefused):
            raise RefusedError(refused_text(answer.identify))
        identify = answer.identify
        assert identify is not None, "a host's link has it"
        status = await self.refresh_status()
        await agree_on_configuration(self, identify, status, board_config)
        self._consistency = Consistency(board_config, self._may_still_be_obeyed)
        return identify

    # -------------------------------------------------------------------------------------------- messages

    def post(self, message: Message) -> None:
        """Hand a message to the link; raises the session's failure, LinkFullError."""
        self._raise_failure()
        self.link.send(message)
        if isinstance(message, SetPositions) and self._consistency is not None:
            self._consistency.positions_set(message)
        self._schedule_pump()

    async def request(self, message: Message, reply: type[M], timeout_s: float = COMMAND_TIMEOUT_S) -> M:
        """Send and wait for a message of type `reply`; raises BoardRefusedError when the board refuses `message`."""

        def answers(notice: _Heard) -> M | None:
            if isinstance(notice, Refused) and notice.message_id == message.ID:
                raise BoardRefusedError(notice)
            return notice if isinstance(notice, reply) else None

        answer = self._expect(answers)
        self.post(message)
        return await self._within(answer, timeout_s, f"{reply.__name__} in answer to {type(message).__name__}")

    async def command(
        self, message: Message, until: Callable[[Status], bool], timeout_s: float = COMMAND_TIMEOUT_S
    ) -> Status:
        """Send and wait until a status from after it satisfies `until`; raises BoardRefusedError when refused.

        Messages that are declared urgent (Hold, Resume, Truncate) go ahead of segments that wait for a free slot. Any
        other waits behind them; one that could not be sent in time is taken back, so that it is not obeyed later, and
        StoppedError says so.
        """

        def refusal(notice: _Heard) -> Status | None:
            if isinstance(notice, Refused) and notice.message_id == message.ID:
                raise BoardRefusedError(notice)
            return None

        refused = self._expect(refusal)
        try:
            self.post(message)
            async with asyncio.timeout(timeout_s):
                await self._acknowledged(message)
                while True:
                    status = await self.refresh_status()
                    if refused.done():
                        refused.result()
                    if until(status):
                        return status
                    await asyncio.sleep(_POLL_S)
        except TimeoutError:
            if self.link.take_back(lambda waiting: waiting is message):
                raise StoppedError(
                    f"{type(message).__name__} was not sent: it waited {timeout_s:.0f} s behind {self.link.pending} "
                    "messages for which the board has no room; it is taken back, send it when the motion has ended"
                ) from None
            raise StoppedError(
                f"the board took {type(message).__name__} but did not do it within {timeout_s:.0f} s "
                f"(state {self.status.state.name if self.status else 'unknown'}); look at its status, then reset it"
            ) from None
        finally:
            refused.cancel()

    async def withdraw_motion(self, timeout_s: float = COMMAND_TIMEOUT_S) -> None:
        """Take back segments and starts that were not sent yet, and wait until the board has what was: from then on
        its status tells all there is. Raises StoppedError when it does not take it.
        """
        self._raise_failure()
        self.link.take_back(lambda waiting: isinstance(waiting, Segment | Start))
        try:
            async with asyncio.timeout(timeout_s):
                while self.link.pending or self.link.unacknowledged:
                    self._raise_failure()
                    await asyncio.sleep(_POLL_S)
        except TimeoutError:
            raise StoppedError(
                f"the board did not take what is on its way within {timeout_s:.0f} s; look at its status, then reset it"
            ) from None

    async def refresh_status(self, timeout_s: float = COMMAND_TIMEOUT_S) -> Status:
        """Ask for a status and wait for one."""
        answer = self._expect(lambda notice: notice if isinstance(notice, Status) else None)
        self.post(StatusRequest())
        return await self._within(answer, timeout_s, "Status")

    async def wait_for(
        self, wanted: Callable[[Notice], T | None], timeout_s: float | None = None, what: str = "a message"
    ) -> T:
        """Wait until `wanted` gives something else than None for a notice; what it raises is raised here."""
        future = self._expect(
            lambda notice: None if isinstance(notice, SessionOpened | SessionRefused) else wanted(notice)
        )
        return await self._within(future, timeout_s, what)

    def add_listener(self, listener: Callable[[Notice], None]) -> Callable[[], None]:
        """Call `listener` with every notice from now on; the returned function ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    async def stop(self, kind: StopKind = StopKind.STOP) -> None:
        """Stop ahead of everything; returns when the board has taken it. Nothing sent before will run after it."""
        self._raise_failure()
        acknowledged = self._expect(lambda notice: notice if isinstance(notice, StopAcknowledged) else None)
        self.link.stop(kind, self._now_us())
        self._pump()
        await self._within(acknowledged, _STOP_TIMEOUT_S, "the acknowledgement of a stop")

    def give_up(self, reason: str) -> None:
        """Take the connection for lost: everyone who waits gets a LinkLostError with `reason`, and so does every later
        call.
        """
        self._fail(
            LinkLostError(
                f"the connection to the board is lost: {reason}; a moving arm holds on its path by itself: "
                "restore the connection, then look at the status before you resume or home again",
                reason,
            )
        )

    async def aclose(self) -> None:
        """End the session and let go of the port; may be called twice."""
        self._closing = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        await self._transport.aclose()

    @property
    def has_stalled(self) -> bool:
        """Whether nothing was heard for a second, now or until just now: this process stood still, or the line did."""
        return self.silence_s > 0.0

    @property
    def silence_s(self) -> float:
        """For how long nothing (or nothing intelligible) is heard, or was until just now; 0 where that is less than a
        second.
        """
        now_s = self._loop.time()
        heard_s = self._silent_since_s if self.link_silent else self._data_s
        if heard_s is not None and now_s - heard_s >= STALL_S:
            return now_s - heard_s
        ended_s = self._stall_ended_s
        return self._stall_s if ended_s is not None and now_s - ended_s <= _JUST_NOW_S else 0.0

    @property
    def noise_warning(self) -> str | None:
        """What is wrong with the line, None while at most one frame in a hundred is broken."""
        if self._noise is None or self._loop.time() - self._noise_s > _NOISE_REMEMBERED_S:
            return None
        return noise_text(self._noise)

    @property
    def failure(self) -> Rm501Error | None:
        """Why this session is over, None while it is not."""
        return self._failure

    # ----------------------------------------------------------------------------- receiver of a transport

    def data_received(self, data: bytes) -> None:
        """Bytes from the transport."""
        if self._closing:
            return
        now_us = self._now_us()
        now_s = self._loop.time()
        if self._data_s is not None and now_s - self._data_s >= STALL_S:
            self._stall_ended_s, self._stall_s = now_s, now_s - self._data_s
        self._data_s = now_s
        if self._wire_tap is not None:
            self._wire_tap(now_us, "in", data)
        self.link.receive_data(data, now_us)
        self._pump()

    def connection_lost(self, exc: Exception | None) -> None:
        """The transport is gone."""
        if not self._closing:
            self.give_up(str(exc) if exc is not None else "the other end closed it")

    # ------------------------------------------------------------------------------------------- machinery

    def _now_us(self) -> int:
        return round(self._loop.time() * 1e6)

    def _schedule_pump(self) -> None:
        if not self._pump_scheduled:
            self._pump_scheduled = True
            self._loop.call_soon(self._scheduled_pump)

    def _scheduled_pump(self) -> None:
        self._pump_scheduled = False
        self._pump()

    def _pump(self) -> None:
        """Hand on what the link has for its user and for the line, and set the timer to its next deadline."""
        if self._closing or self._failure is not None:
            return
        now_us = self._now_us()
        self._drain()
        for packet in self.link.packets_to_send(now_us):
            if self._wire_tap is not None:
                self._wire_tap(now_us, "out", packet)
            self._transport.write(packet)
        self._drain()
        for message, future in tuple(self._confirming):
            if not self.link.on_its_way(message):
                self._confirming.remove((message, future))
                if not future.done():
                    future.set_result(None)
        if self._timer is not None:
            self._timer.cancel()
        deadline_us = self.link.next_deadline_us()
        self._timer = None if deadline_us is None else self._loop.call_at(deadline_us / 1e6, self._pump)

    def _drain(self) -> None:
        while (event := self.link.next_event()) is not None:
            self._handle(event)

    def _handle(self, event: Event) -> None:
        match event:
            case Received(message=Status() | MotionEnded() as report) if self._is_nobodys(report):
                pass
            case Received(message=Status() as status):
                self.status = status
                self.motion_frames.read(status.motion_frame)
                self.real_frames.read(status.real_frame)
                self._tell(status)
            case Received(message=message):
                self._tell(message)
            case SessionOpened() | SessionRefused():
                self._wake(event)
            case SessionLost(reason=reason):
                self._tell(event)
                self._fail(SessionLostError(reason))
            case LinkSilent(silent_us=silent_us):
                self.link_silent = True
                self._silent_since_s = self._loop.time() - silent_us * 1e-6
                self._tell(event)
            case LinkHeard():
                self.link_silent = False
                self._tell(event)
            case LinkNoisy():
                self._noise, self._noise_s = event, self._loop.time()
                self._tell(event)
            case StopAcknowledged() | GenerationAdvanced():
                self._tell(event)
            case _:
                pass

    def _may_still_be_obeyed(self, message: Message) -> bool:
        """Whether it is on its way, or a stop has overtaken it of which nobody knows yet where it met the board."""
        return self.link.stopping or self.link.on_its_way(message)

    def _is_nobodys(self, report: Status | MotionEnded) -> bool:
        """Whether a report is older than what is known, or cannot be; then the session is over."""
        if self._failure is not None:
            return True
        if self._consistency is None:
            return False
        if isinstance(report, Status) and self._consistency.is_outdated(report, self._now_us()):
            return True
        found = self._consistency.contradiction_in(report)
        if found is not None:
            self._fail(ContradictionError(found))
        return found is not None

    def _tell(self, notice: Notice) -> None:
        for listener in tuple(self._listeners):
            listener(notice)
        self._wake(notice)

    def _wake(self, notice: _Heard) -> None:
        for future, wanted in tuple(self._waiters.items()):
            if future.done():
                continue
            try:
                result = wanted(notice)
            except Rm501Error as error:
                future.set_exception(error)
            else:
                if result is not None:
                    future.set_result(result)

    def _expect(self, wanted: Callable[[_Heard], T | None]) -> asyncio.Future[T]:
        self._raise_failure()
        future: asyncio.Future[T] = self._loop.create_future()
        self._waiters[future] = wanted
        future.add_done_callback(self._forget)
        return future

    def _forget(self, future: asyncio.Future[Any]) -> None:
        self._waiters.pop(future, None)
        if not future.cancelled():
            future.exception()

    async def _within(self, future: asyncio.Future[T], timeout_s: float | None, what: str) -> T:
        try:
            async with asyncio.timeout(timeout_s):
                return await future
        except TimeoutError:
            if future.done() and not future.cancelled():
                return future.result()  # it came while this process stood still beyond the time limit
            raise LinkLostError(
                f"the board did not send {what} within {timeout_s:.0f} s; check the connection and the board's power"
            ) from None

    async def _acknowledged(self, message: Message) -> None:
        """Wait until the board has `message`, or it was dropped by a stop."""
        future: asyncio.Future[None] = self._loop.create_future()
        self._confirming.append((message, future))
        self._schedule_pump()
        try:
            await future
        finally:
            if (message, future) in self._confirming:
                self._confirming.remove((message, future))

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _fail(self, error: Rm501Error) -> None:
        if self._failure is not None:
            return
        self._failure = error
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for future in (*self._waiters, *(future for _, future in self._confirming)):
            if not future.done():
                future.set_exception(error)


def noise_text(noise: LinkNoisy) -> str:
    """A bad line in words, with its figures."""
    share = noise.bad_frames / noise.frames
    return (
        f"the line to the board is bad: {noise.bad_frames} of {noise.frames} frames were broken ({share:.1%}); nothing "
        "is lost, they are sent again: check the cable, its shield and the ground, and keep it away from the motors"
    )


async def open_session(
    opening: Coroutine[Any, Any, Transport],
    board_config: BoardConfig,
    nonce: Callable[[], int],
    wire_tap: WireTap | None = None,
) -> BoardSession:
    """Open the transport, shake hands, configure; raises NoBoardError, RefusedError. Nothing stays open on an error."""
    try:
        transport = await opening
    except OSError as error:
        raise NoBoardError(f"the port cannot be opened: {error}") from error
    session = BoardSession(transport, nonce, wire_tap)
    try:
        await session.handshake(board_config)
    except BaseException:
        await session.aclose()
        raise
    return session
