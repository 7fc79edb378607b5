"""The stand-in's files: answers as ArduPilot gives them, and to nonsense too."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.mavlink.ftp import Opcode, Packet, Trouble, read_packet
from upwash.vehicle.body.ftp import Files

ME, SOMEBODY = (1, 191), (255, 190)


def ask(files: Files, packet: Packet, *, sender: object = ME, now_s: float = 0.0) -> Packet:
    answer = files.answer(packet.payload(), sender, now_s)
    assert answer is not None
    read = read_packet(answer)
    assert read is not None and read.number == (packet.number + 1) % 2**16 and read.asked == packet.opcode
    return read


def refused(answer: Packet) -> Trouble:
    assert answer.opcode == Opcode.NAK
    return Trouble(answer.data[0])


def test_a_request_that_is_repeated_is_carried_out_once() -> None:
    files = Files()
    ask(files, Packet(65_535, 0, Opcode.CREATE_FILE, data=b"scripts/a.lua"))
    for _ in range(2):
        write = Packet(0, 0, Opcode.WRITE_FILE, data=b"text")
        assert ask(files, write).opcode == Opcode.ACK
    assert refused(ask(files, Packet(1, 0, Opcode.CREATE_FILE, data=b"scripts/b.lua"))) == Trouble.FAIL
    assert files.content == {"scripts/a.lua": bytearray(b"text")}


@pytest.mark.parametrize(("now_s", "trouble"), [(1.0, Trouble.INVALID_SESSION), (5.0, None)])
def test_what_is_open_is_its_sessions_until_that_is_idle(now_s: float, trouble: Trouble | None) -> None:
    files = Files()
    ask(files, Packet(1, 7, Opcode.CREATE_FILE, data=b"scripts/a.lua"))
    other = Packet(1, 0, Opcode.CREATE_FILE, data=b"scripts/b.lua")
    answer = ask(files, other, sender=SOMEBODY, now_s=now_s)
    assert (refused(answer) if answer.opcode == Opcode.NAK else None) == trouble


def test_what_is_not_there_is_refused() -> None:
    files = Files()
    opened = ask(files, Packet(1, 0, Opcode.OPEN_FILE_READ_ONLY, data=b"scripts/none"))
    assert refused(opened) == Trouble.FILE_NOT_FOUND
    assert refused(ask(files, Packet(2, 0, Opcode.READ_FILE, size=10))) == Trouble.FILE_NOT_FOUND
    assert refused(ask(files, Packet(3, 0, Opcode.LIST_DIRECTORY, data=b"none"))) == Trouble.FILE_NOT_FOUND
    assert refused(ask(files, Packet(4, 0, Opcode.LIST_DIRECTORY, data=b"scripts"))) == Trouble.END_OF_FILE
    assert refused(ask(files, Packet(5, 0, Opcode.CREATE_FILE, data=b"none/a"))) == Trouble.FILE_NOT_FOUND
    assert refused(ask(files, Packet(6, 0, Opcode.CREATE_DIRECTORY, data=b"logs"))) == Trouble.FILE_EXISTS
    assert refused(ask(files, Packet(7, 0, 99))) == Trouble.FAIL


def test_a_file_does_not_grow_for_ever() -> None:
    files = Files()
    ask(files, Packet(1, 0, Opcode.CREATE_FILE, data=b"scripts/a"))
    far = Packet(2, 0, Opcode.WRITE_FILE, offset=2**31, data=b"x")
    assert refused(ask(files, far)) == Trouble.FAIL_ERRNO
    assert files.content["scripts/a"] == bytearray()


@given(st.binary(max_size=260))
def test_nonsense_is_answered_or_ignored(payload: bytes) -> None:
    answer = Files().answer(payload, ME, 0.0)
    assert answer is None or len(answer) == 251
    packet = read_packet(payload)
    assert packet is None or len(packet.data) <= 239


def test_a_great_deal_of_it_leaves_little_behind() -> None:
    files, chance = Files(), random.Random(3)
    for number in range(5_000):
        data = chance.randbytes(chance.randrange(12))
        head = struct.pack(
            "<HBBBBBxI", number, 0, chance.randrange(20), len(data), 0, 0, chance.randrange(2**32)
        )
        files.answer((head + data).ljust(251, b"\0"), ME, float(number))
    assert len(files.content) <= 100
    assert sum(map(len, files.content.values())) <= 100 * 65_536
