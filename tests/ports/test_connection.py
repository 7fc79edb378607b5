"""A MAVLink connection: when it is opened again, what it says of a silence, and what it does not wait for."""

from __future__ import annotations

import asyncio
import os
import socket
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import HOME

from upwash.core.geo import LocalFrame
from upwash.errors import AutopilotNotHeard
from upwash.real.mavlink import MavlinkLink, connect_autopilot


def beat(system: int = 7) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=1)))


# --- in memory ----------------------------------------------------------------------------------------------


@pytest.mark.virtual
async def test_a_connection_is_opened_again_a_second_after_it_failed_or_broke() -> None:
    tried_s: list[float] = []
    lines: list[Any] = []
    sent: list[bytes] = []
    loop = asyncio.get_running_loop()
    begun_s = loop.time()

    async def opening(line: Any) -> None:
        tried_s.append(loop.time() - begun_s)
        match len(tried_s):
            case 1:
                raise OSError("nobody listens")
            case 2:
                raise ConnectionRefusedError(111, "Connection refused")
            case 3:
                await asyncio.sleep(60.0)
        line.write = sent.append
        lines.append(line)

    link = MavlinkLink(opening, lambda _: None)
    reasons: list[str] = []
    for wait_s in 0.5, 1.0, 5.9:
        await asyncio.sleep(wait_s)
        reasons.append(link.why_silent)
        link.send_bytes(b"dropped")
        assert not link.opened.is_set()
    assert reasons == [" (nobody listens)", " (Connection refused)", " (no answer)"]
    await link.opened.wait()
    assert link.opened_s == begun_s + 8.0
    link.send_bytes(b"one")
    link.reopen_if_dead(0.0)  # which is for TCP alone
    await asyncio.sleep(3.0)
    assert link.opened.is_set() and len(lines) == 1
    lines[0].connection_lost(None)
    await asyncio.sleep(0.5)
    assert not link.opened.is_set()
    assert link.why_silent == " (closed by the other side)"
    link.send_bytes(b"dropped")
    await asyncio.sleep(0.75)
    link.send_bytes(b"two")
    assert link.opened.is_set()
    assert tried_s == [0.0, 1.0, 2.0, 8.0, 12.0]
    assert sent == [b"one", b"two"]
    lines[1].connection_lost(OSError("it broke"))
    await asyncio.sleep(0.5)
    assert link.why_silent == " (it broke)"
    await link.close()
    await asyncio.sleep(5.0)
    assert len(tried_s) == 5


@pytest.mark.virtual
async def test_a_driver_that_finds_no_vehicle_leaves_nothing_behind() -> None:
    async def opening(_: Any) -> None:
        raise OSError("nobody listens")

    before = asyncio.all_tasks()
    with pytest.raises(AutopilotNotHeard):
        await connect_autopilot(
            opening, frame=LocalFrame(HOME), ground_speed_m_s=4.0, heartbeat_timeout_s=2.0
        )
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before


# --- sockets ------------------------------------------------------------------------------------------------


@contextmanager
def sender() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        yield made


def free_port() -> int:
    with sender() as made:
        return int(made.getsockname()[1])


async def test_a_flood_of_datagrams_leaves_the_loop_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, heard, turns = asyncio.get_running_loop(), [0], list[int]()
    time_s, work_s = loop.time, 0.004

    def hear(_: Any) -> None:
        heard[0] += 1
        if heard[0] == 1:
            loop.call_soon(lambda: turns.append(heard[0]))

    link = MavlinkLink(f"udpin:127.0.0.1:{free_port()}", hear)
    await link.opened.wait()
    port = int(link.connection.rpartition(":")[2])
    with sender() as vehicle:
        for _ in range(100):
            vehicle.sendto(beat(), ("127.0.0.1", port))
        monkeypatch.setattr(loop, "time", lambda: time_s() + work_s * heard[0])
        async with asyncio.timeout(20.0):
            while heard[0] < 100:  # noqa: ASYNC110 - the datagrams are there already
                await asyncio.sleep(0)
        monkeypatch.undo()
    assert 1 <= turns[0] <= 3, "of datagrams that take 4 ms each, in 10 ms"
    await link.close()


async def test_the_reasons_of_a_silence_are_told_together() -> None:
    port = free_port()
    heard: asyncio.Queue[Any] = asyncio.Queue()
    link = MavlinkLink(f"udpin:127.0.0.1:{port}", heard.put_nowait)
    await link.opened.wait()
    assert link.why_silent == ""
    with sender() as vehicle, sender() as other:
        vehicle.sendto(beat(), ("127.0.0.1", port))
        async with asyncio.timeout(5.0):
            await heard.get()
            for _ in range(2):
                other.sendto(beat(8), ("127.0.0.1", port))
            vehicle.sendto(beat(), ("127.0.0.1", port))
            await heard.get()
        ignored = f"2 datagrams of others ignored, the last from 127.0.0.1:{other.getsockname()[1]}"
        assert link.why_silent == f" ({ignored})"
        link.trouble = "it broke"
        assert link.why_silent == f" (it broke; {ignored})"
    await link.close()


async def test_a_port_that_is_taken_is_told_and_free_after_the_end() -> None:
    with sender() as taken:
        port = taken.getsockname()[1]
        link = MavlinkLink(f"udpin:127.0.0.1:{port}", lambda _: None)
        while not link.trouble:  # noqa: ASYNC110 - it is tried at once
            await asyncio.sleep(0)
        assert "in use" in link.why_silent
        await link.close()
    link = MavlinkLink(f"udpin:127.0.0.1:{port}", lambda _: None)
    await link.opened.wait()
    await link.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))


async def test_tcp_is_broken_off_only_if_nothing_came_of_anybody() -> None:
    others: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
    server = await asyncio.start_server(lambda _, writer: others.put_nowait(writer), "127.0.0.1", 0)
    heard: asyncio.Queue[Any] = asyncio.Queue()
    link = MavlinkLink(f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}", heard.put_nowait)
    async with asyncio.timeout(10.0):
        ground_station = await others.get()
        await link.opened.wait()
        await asyncio.sleep(0.2)
        ground_station.write(beat(255))
        await heard.get()
        link.reopen_if_dead(0.15)
        await asyncio.sleep(0.05)
        assert link.opened.is_set(), "a ground station's heartbeat came"
        await asyncio.sleep(0.2)
        link.reopen_if_dead(0.15)
        await asyncio.sleep(0.05)
        assert not link.opened.is_set()
        assert link.why_silent == " (nothing came)"
        ground_station.close()
        ground_station = await others.get()
        ground_station.write(beat(255))
        await heard.get()
        assert link.why_silent == ""
    await link.close()
    ground_station.close()
    server.close()


async def test_a_computer_that_reads_nothing_costs_messages_and_no_memory() -> None:
    read, reads = [0], asyncio.Event()

    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reads.wait()
        while data := await reader.read(2**20):
            read[0] += len(data)
        writer.close()

    server = await asyncio.start_server(take, "127.0.0.1", 0)
    link = MavlinkLink(f"tcp:127.0.0.1:{server.sockets[0].getsockname()[1]}", lambda _: None)
    await link.opened.wait()
    part, times = bytes(50_000), 1000
    for _ in range(times):
        link.send_bytes(part)
    reads.set()
    before = -1
    while read[0] > before:
        before = read[0]
        for _ in range(50):
            await asyncio.sleep(0)
    await link.close()
    link.send_bytes(part)
    server.close()
    await server.wait_closed()
    assert read[0] < times * len(part)


# --- serial ports -------------------------------------------------------------------------------------------


@contextmanager
def port_with(change: Callable[[list[Any]], None]) -> Iterator[int]:
    ours, theirs = os.openpty()
    attributes = termios.tcgetattr(theirs)
    change(attributes)
    termios.tcsetattr(theirs, termios.TCSANOW, attributes)
    yield theirs
    os.close(ours)
    os.close(theirs)


def with_flow_control(attributes: list[Any]) -> None:
    attributes[2] = (attributes[2] | termios.CRTSCTS) & ~termios.CLOCAL & ~termios.CREAD


async def test_a_serial_port_is_raw_without_flow_control_at_its_speed() -> None:
    with port_with(with_flow_control) as port:
        link = MavlinkLink(f"serial:{os.ttyname(port)}:57600", lambda _: None)
        await link.opened.wait()
        control, local, *speeds = (termios.tcgetattr(port)[index] for index in (2, 3, 4, 5))
        await link.close()
        assert control & termios.CLOCAL and control & termios.CREAD
        assert not control & termios.CRTSCTS
        assert not local & (termios.ECHO | termios.ICANON)
        assert speeds == [termios.B57600] * 2


async def test_what_is_no_serial_port_is_told() -> None:
    link = MavlinkLink("serial:/dev/null:57600", lambda _: None)
    while not link.trouble:  # noqa: ASYNC110 - it is tried at once
        await asyncio.sleep(0)
    assert link.why_silent == " (Inappropriate ioctl for device)"
    await link.close()
