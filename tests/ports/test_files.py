"""What is asked of a vehicle about its files, answer by answer (MAVLink FTP)."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.scripted import SYSTEM, Script, scripted

from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.mavlink.ftp import MOST_DATA_BYTES, Opcode, Packet, Trouble, read_packet
from upwash.real.mavlink.ftp import MOST_FILE_BYTES, FileClient, FileRefused
from upwash.sim.loop import run_virtually

SESSION, COMPANION = 3, 191


class Files(Script):
    """A vehicle with files; a test may have it answer otherwise."""

    def __init__(self, *, armed: bool) -> None:
        super().__init__(armed=armed)
        self.content: dict[str, bytes] = {"some.lua": b"some text"}
        self.directories = {"scripts"}
        self.asked: list[Packet] = []
        self.refuses: dict[Opcode, bytes] = {}  # what the answer's data are
        self.first: Callable[[Packet], list[tuple[Packet, int]]] = (
            lambda _: []
        )  # with the receivers' components
        self.takes_s = 0.0
        self._open = ""

    @property
    def client(self) -> FileClient:
        return FileClient(self.autopilot.vehicle)

    def opcodes(self) -> list[str]:
        return [Opcode(request.opcode).name for request in self.asked]

    def _answer(self, message: Any) -> None:
        if message.get_type() != "FILE_TRANSFER_PROTOCOL":
            super()._answer(message)
            return
        assert (message.target_network, message.target_system, message.target_component) == (0, SYSTEM, 1)
        request = read_packet(bytes(message.payload))
        assert request is not None
        self.asked.append(request)
        right = self._obeyed(request)
        answers = [*self.first(request), *([(right, COMPANION)] if right else [])]
        asyncio.get_running_loop().call_later(self.takes_s, self._send, [packed(*each) for each in answers])

    def _obeyed(self, request: Packet) -> Packet | None:
        name, opcode = request.data.decode("latin-1"), Opcode(request.opcode)
        if opcode in self.refuses:
            return answer(request, Opcode.NAK, self.refuses[opcode])
        match opcode:
            case Opcode.LIST_DIRECTORY if name not in self.directories:
                return answer(request, Opcode.NAK, bytes([Trouble.FAIL]))
            case Opcode.OPEN_FILE_READ_ONLY if name not in self.content:
                return answer(request, Opcode.NAK, bytes([Trouble.FILE_NOT_FOUND]))
            case Opcode.OPEN_FILE_READ_ONLY | Opcode.CREATE_FILE:
                self._open = name
                self.content |= {name: b""} if opcode == Opcode.CREATE_FILE else {}
            case Opcode.WRITE_FILE:
                before = self.content[self._open]
                self.content[self._open] = before[: request.offset] + request.data
            case Opcode.READ_FILE:
                part = self.content[self._open][request.offset :][:MOST_DATA_BYTES]
                kind, data = (Opcode.ACK, part) if part else (Opcode.NAK, bytes([Trouble.END_OF_FILE]))
                return answer(request, kind, data)
        return answer(request, Opcode.ACK, b"")


def answer(request: Packet, kind: Opcode, data: bytes, **other: int) -> Packet:
    named = {
        "asked": request.opcode,
        "offset": request.offset,
        "number": (request.number + 1) % 2**16,
    } | other
    return Packet(session=named.pop("session", SESSION), opcode=kind, data=data, **named)


def packed(packet: Packet, component: int) -> Any:
    return mavlink.MAVLink_file_transfer_protocol_message(0, SYSTEM, component, list(packet.payload()))


def tell(story: Callable[[Files], Awaitable[None]]) -> None:
    async def live() -> None:
        async with scripted(kind=Files) as script:
            assert isinstance(script, Files)
            await story(script)

    run_virtually(live())


@played(tell)
async def test_a_file_is_read_part_by_part_between_two_resets(script: Files) -> None:
    script.content["some.lua"] = bytes(range(256)) * 2
    assert await script.client.read("some.lua") == bytes(range(256)) * 2
    parts = ["READ_FILE"] * 4
    assert script.opcodes() == ["RESET_SESSIONS", "OPEN_FILE_READ_ONLY", *parts, "RESET_SESSIONS"]
    assert [request.offset for request in script.asked[2:6]] == [0, 239, 478, 512]
    assert {(request.session, len(request.data)) for request in script.asked[2:6]} == {(SESSION, 239)}
    others = [script.asked[index] for index in (0, 1, -1)]
    assert [(request.session, request.offset) for request in others] == [(0, 0)] * 3
    numbers = [request.number for request in script.asked]
    assert numbers == [(numbers[0] + more) % 2**16 for more in range(7)]


@played(tell)
async def test_a_file_is_written_part_by_part_and_read_back(script: Files) -> None:
    text = bytes(range(250))
    await script.client.write("other.lua", text)
    assert script.content["other.lua"] == text
    wrote = ["RESET_SESSIONS", "CREATE_FILE", "WRITE_FILE", "WRITE_FILE"]
    read = ["RESET_SESSIONS", "OPEN_FILE_READ_ONLY", "READ_FILE", "READ_FILE", "READ_FILE", "RESET_SESSIONS"]
    assert script.opcodes() == wrote + read
    sent = [(request.session, request.offset, request.data) for request in script.asked[2:4]]
    assert sent == [(SESSION, 0, text[:239]), (SESSION, 239, text[239:])]


@played(tell)
async def test_what_is_read_back_otherwise_is_refused_after_four_transfers(script: Files) -> None:
    def first(request: Packet) -> list[tuple[Packet, int]]:
        if request.opcode != Opcode.READ_FILE or request.offset:
            return []
        return [(answer(request, Opcode.ACK, b"other"), COMPANION)]

    script.first = first
    with pytest.raises(FileRefused, match=r"FAIL to read back what was written to some\.lua"):
        await script.client.write("some.lua", b"text")
    assert script.opcodes().count("CREATE_FILE") == 4


@pytest.mark.parametrize(
    ("refuses", "there"),
    [
        ({}, True),
        ({Opcode.LIST_DIRECTORY: bytes([Trouble.END_OF_FILE])}, True),  # it is empty
        ({Opcode.LIST_DIRECTORY: bytes([Trouble.FILE_NOT_FOUND])}, False),
    ],
)
@played(tell)
async def test_a_directory_is_there_if_it_can_be_listed(
    script: Files, *, refuses: dict[Opcode, bytes], there: bool
) -> None:
    script.refuses = refuses
    assert await script.client.has_directory("scripts") is there
    assert [request.data for request in script.asked] == [b"scripts"]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (bytes([Trouble.FILE_EXISTS]), ""),
        (bytes([Trouble.FILE_PROTECTED]), "FILE_PROTECTED to make scripts"),
        (bytes([Trouble.FAIL_ERRNO, 13]), "FAIL_ERRNO to make scripts"),
        (bytes([77]), "number 77 to make scripts"),
        (b"", "FAIL to make scripts"),
    ],
)
@played(tell)
async def test_a_directory_that_exists_is_no_refusal(script: Files, *, data: bytes, said: str) -> None:
    script.refuses = {Opcode.CREATE_DIRECTORY: data}
    making = asyncio.ensure_future(script.client.make_directory("scripts"))
    if said:
        with pytest.raises(AutopilotRefused, match=f"the vehicle answered {said}"):
            await making
    else:
        await making
    assert script.opcodes() == ["CREATE_DIRECTORY"]


@pytest.mark.parametrize(
    ("opcode", "trouble", "times"),
    [
        (Opcode.OPEN_FILE_READ_ONLY, Trouble.FILE_NOT_FOUND, 1),
        (Opcode.OPEN_FILE_READ_ONLY, Trouble.NO_SESSIONS_AVAILABLE, 4),
        (Opcode.READ_FILE, Trouble.END_OF_FILE, 1),
        (Opcode.READ_FILE, Trouble.INVALID_SESSION, 4),
    ],
)
@played(tell)
async def test_a_refused_transfer_is_repeated_three_times(
    script: Files, *, opcode: Opcode, trouble: Trouble, times: int
) -> None:
    script.refuses = {opcode: bytes([trouble])}
    reading = asyncio.ensure_future(script.client.read("some.lua"))
    if times == 1:
        assert await reading == (None if trouble == Trouble.FILE_NOT_FOUND else b"")
    else:
        with pytest.raises(FileRefused, match=trouble.name):
            await reading
    assert script.opcodes().count("OPEN_FILE_READ_ONLY") == times


@pytest.mark.parametrize(("size", "read"), [(MOST_FILE_BYTES, True), (MOST_FILE_BYTES + 1, False)])
@played(tell)
async def test_a_file_that_is_too_long_is_refused_at_once(script: Files, *, size: int, read: bool) -> None:
    assert MOST_FILE_BYTES == 2**16
    script.content["some.lua"] = bytes(size)
    reading = asyncio.ensure_future(script.client.read("some.lua"))
    if read:
        assert await reading == bytes(size)
    else:
        with pytest.raises(AutopilotRefused, match=r"some\.lua is longer than 65536 bytes"):
            await reading
        assert script.opcodes().count("OPEN_FILE_READ_ONLY") == 1


Change = Callable[[Packet], tuple[Packet, int]]


def another(component: int = COMPANION, kind: Opcode = Opcode.ACK, **other: int) -> Change:
    return lambda request: (answer(request, kind, b"wrong", **other), component)


@pytest.mark.parametrize(
    ("change", "believed"),
    [
        (another(), True),
        (another(component=0), True),
        (another(component=1), False),
        (another(component=190), False),
        (another(kind=Opcode.READ_FILE), False),
        (another(number=7), False),
        (another(asked=Opcode.OPEN_FILE_READ_ONLY), False),
        (another(offset=5), False),
        (another(session=SESSION + 1), False),
    ],
)
@played(tell)
async def test_an_answer_counts_for_its_own_question_alone(
    script: Files, *, change: Change, believed: bool
) -> None:
    script.first = lambda request: (
        [change(request)] if request.opcode == Opcode.READ_FILE and not request.offset else []
    )
    text = await script.client.read("some.lua")
    assert text == (b"wrongtext" if believed else b"some text")


@pytest.mark.parametrize("begins", [2**16 - 1, 2**16 - 2, 2**16 - 3])
@pytest.mark.virtual
async def test_numbers_begin_again_after_the_last(monkeypatch: pytest.MonkeyPatch, begins: int) -> None:
    monkeypatch.setattr(secrets, "randbelow", lambda _: begins)
    async with scripted(kind=Files) as script:
        assert isinstance(script, Files)
        assert await script.client.read("some.lua") == b"some text"
        assert [request.number for request in script.asked] == [
            (begins + 1 + more) % 2**16 for more in range(5)
        ]


@played(tell)
async def test_a_question_is_repeated_with_its_number_and_given_up_after_twelve_seconds(
    script: Files,
) -> None:
    script.takes_s, begun_s = 60.0, script.now_s
    with pytest.raises(AutopilotTimeout, match="no answer to: list scripts"):
        await script.client.has_directory("scripts")
    assert len(script.asked) == 12
    assert len({request.number for request in script.asked}) == 1
    assert script.now_s - begun_s == pytest.approx(12.0, abs=0.01)


@played(tell)
async def test_a_transfer_has_ten_minutes(script: Files) -> None:
    script.takes_s, begun_s = 0.9, script.now_s
    script.content["some.lua"] = b"x"
    script.first = lambda request: (
        [(answer(request, Opcode.ACK, b"more"), COMPANION)] if request.opcode == Opcode.READ_FILE else []
    )
    with pytest.raises(AutopilotTimeout, match="files: not done within 600 s"):
        await script.client.read("some.lua")
    assert 600.0 <= script.now_s - begun_s < 601.0
