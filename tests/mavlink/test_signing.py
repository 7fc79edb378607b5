"""Who holds the key made a packet, and when."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import PacketReader, packed
from upwash.mavlink.px4 import CurrentModeMessage
from upwash.mavlink.signing import TICKS_PER_S, SignatureRefusal, Signing, key_of, key_of_passphrase

KEY = bytes(range(32))
NOW_S = 1.8e9
NOW = round((NOW_S - 1_420_070_400) * TICKS_PER_S)


def beat() -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3)


def codec(system: int = 1) -> Any:
    return mavlink.MAVLink(None, srcSystem=system, srcComponent=1)


def at(time_s: float, key: bytes = KEY, **named: Any) -> Signing:
    return Signing(key, unix_s=lambda: time_s, **named)


def made_at(packet: bytes) -> int:
    return int.from_bytes(packet[-12:-6], "little")


def refusals(signing: Signing, *packets: bytes) -> list[SignatureRefusal | None]:
    reader = PacketReader(signing)
    return [refusal for packet in packets for _, refusal in reader.read(packet)]


def test_what_pymavlink_signs_is_believed_and_the_other_way_round() -> None:
    theirs = codec()
    theirs.signing.secret_key, theirs.signing.sign_outgoing = KEY, True
    theirs.signing.timestamp = NOW
    packet = bytes(beat().pack(theirs))
    assert refusals(at(NOW_S), packet) == [None]
    read = theirs.parse_buffer(at(NOW_S + 1).pack(beat(), codec(7)))
    assert [(message.get_srcSystem(), message.get_signed()) for message in read] == [(7, True)]


def test_unsigned_packets_of_another_key_and_altered_ones_are_refused() -> None:
    plain = bytes(beat().pack(codec()))
    old_protocol = bytes(beat().pack(codec(), force_mavlink1=True))
    assert refusals(at(NOW_S), plain, old_protocol) == [SignatureRefusal.UNSIGNED] * 2
    assert refusals(at(NOW_S), at(NOW_S, bytes(32)).pack(beat(), codec())) == [SignatureRefusal.OTHER_KEY]
    later = bytearray(at(NOW_S).pack(beat(), codec()))
    later[-12] ^= 1
    assert refusals(at(NOW_S), bytes(later)) == [SignatureRefusal.OTHER_KEY]


def test_a_message_that_pymavlink_does_not_know_has_to_be_signed_too() -> None:
    fields = dict.fromkeys(CurrentModeMessage.fieldnames, 0)
    assert refusals(at(NOW_S), bytes(CurrentModeMessage(**fields).pack(codec()))) == [
        SignatureRefusal.UNSIGNED
    ]
    signed = at(NOW_S).pack(CurrentModeMessage(**fields), codec())
    assert refusals(at(NOW_S), signed) == [None]


def test_a_packet_is_believed_once_and_none_after_a_later_one() -> None:
    theirs, ours = at(NOW_S), at(NOW_S)
    first, second = (theirs.pack(beat(), codec()) for _ in range(2))
    assert refusals(ours, first, first, second, first) == [
        None,
        SignatureRefusal.REPLAYED,
        None,
        SignatureRefusal.REPLAYED,
    ]


def test_a_forged_time_changes_nothing_for_the_true_packets_that_follow() -> None:
    ours, theirs = at(NOW_S), at(NOW_S)
    forged = bytearray(at(NOW_S + 1e8, bytes(32)).pack(beat(), codec()))
    packets = theirs.pack(beat(), codec()), bytes(forged), theirs.pack(beat(), codec())
    assert refusals(ours, *packets) == [None, SignatureRefusal.OTHER_KEY, None]
    assert made_at(ours.pack(beat(), codec())) < NOW + 10


def test_a_stream_that_begins_a_minute_late_is_refused() -> None:
    assert refusals(at(NOW_S), at(NOW_S - 59).pack(beat(), codec())) == [None]
    assert refusals(at(NOW_S), at(NOW_S - 61).pack(beat(), codec())) == [SignatureRefusal.STALE]


def test_its_time_follows_the_clock_the_peer_and_what_was_kept_and_never_goes_back() -> None:
    clock = [NOW_S]
    ours = Signing(KEY, unix_s=lambda: clock[0], kept=NOW + 500)
    made = [made_at(ours.pack(beat(), codec()))]
    clock[0] += 100
    made.append(made_at(ours.pack(beat(), codec())))
    clock[0] -= 1e8
    made.append(made_at(ours.pack(beat(), codec())))
    assert refusals(ours, at(NOW_S + 1_000).pack(beat(), codec())) == [None]
    made.append(made_at(ours.pack(beat(), codec())))
    assert made == [
        NOW + 501,
        NOW + 100 * TICKS_PER_S,
        NOW + 100 * TICKS_PER_S + 1,
        NOW + 1_000 * TICKS_PER_S + 1,
    ]


def test_a_computers_clock_that_jumps_by_a_day_costs_no_message_of_either_side() -> None:
    clock = [NOW_S]
    ours, vehicle = Signing(KEY, unix_s=lambda: clock[0]), at(NOW_S)
    for jump_s in (0.0, 86_400.0, -2 * 86_400.0, 0.0):
        clock[0] += jump_s
        assert refusals(ours, vehicle.pack(beat(), codec())) == [None]
        assert refusals(vehicle, ours.pack(beat(), codec(7))) == [None]


def test_what_was_kept_lies_after_all_that_was_signed_or_believed_and_is_kept_rarely() -> None:
    kept: list[int] = []
    clock = [NOW_S]
    ours = Signing(KEY, unix_s=lambda: clock[0], keep=kept.append)
    for _ in range(1_000):  # 20 s
        clock[0] += 0.02
        assert made_at(ours.pack(beat(), codec())) < kept[-1]
    assert len(kept) <= 3
    assert refusals(ours, at(NOW_S + 500).pack(beat(), codec())) == [None]
    assert kept[-1] > NOW + 500 * TICKS_PER_S


def test_the_end_of_time_is_no_error() -> None:
    ours = at(NOW_S)
    theirs = at(NOW_S, kept=2**48 - 2)
    assert refusals(ours, theirs.pack(beat(), codec())) == [None]
    ours.pack(beat(), codec())
    at(-1e12).pack(beat(), codec())
    at(1e12).pack(beat(), codec())


@pytest.mark.parametrize("signing", [None, at(NOW_S)])
def test_a_reader_raises_nothing_and_keeps_little_of_endless_nonsense(signing: Signing | None) -> None:
    chance = random.Random(5)
    reader = PacketReader(signing)
    whole = packed(beat(), codec(), at(NOW_S))
    for _ in range(3_000):
        piece = chance.randbytes(chance.randrange(200)) + whole[: chance.randrange(len(whole))]
        reader.read(piece)
        assert len(reader._parser.buf) < 300
    reader.read(bytes(300))
    assert [message.custom_mode for message, _ in reader.read(whole)] == [4]


def test_messages_that_arrive_in_pieces_are_read() -> None:
    theirs, ours = at(NOW_S), PacketReader(at(NOW_S))
    stream = b"".join(theirs.pack(beat(), codec()) for _ in range(20))
    pieces = [stream[start:end] for start, end in pairwise(range(0, len(stream) + 7, 7))]
    read = [pair for piece in [*pieces, stream[len(pieces) * 7 :]] for pair in ours.read(piece)]
    assert [refusal for _, refusal in read] == [None] * 20


def test_a_key_is_32_bytes_or_as_many_in_hexadecimal_digits() -> None:
    assert key_of(KEY) == key_of(KEY.hex().encode() + b"\n") == key_of(KEY.hex().upper().encode()) == KEY
    for wrong in b"", KEY[:31], KEY + b"\n", KEY.hex().encode()[:-1], b"g" * 64:
        with pytest.raises(ValueError, match="no key"):
            key_of(wrong)


def test_a_passphrase_makes_the_key_that_ground_stations_make() -> None:
    assert key_of_passphrase("abc").hex().startswith("ba7816bf8f01cfea")
