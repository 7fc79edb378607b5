"""MAVLink 2 signing: a packet proves that a holder of the key made it, and when. Repeated packets are refused.

The signature's bytes are made by pymavlink. pymavlink does not check them: it believes a packet's time before it
has looked at the signature, and a forged packet makes it refuse all true packets after it. Nor does it check
messages that its dialect does not know, and some of PX4's are unknown to it.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import time
from collections.abc import Callable
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

KEY_BYTES = 32
TICKS_PER_S = 100_000
_EPOCH_UNIX_S = 1_420_070_400  # 2015-01-01
_LATEST = 2**48 - 1
_NEW_STREAM_TICKS = 60 * TICKS_PER_S  # a new stream may be that far behind
_KEPT_AHEAD_TICKS = 10 * TICKS_PER_S
_SIGNED = 0x01  # of a packet's incompatibility flags
_SIGNATURE_BYTES, _HASH_BYTES = 13, 6
_SHORTEST_BYTES = 10 + 2 + _SIGNATURE_BYTES


class SignatureRefusal(Enum):
    """Why a packet is refused, as a text that continues "its messages"."""

    UNSIGNED = "are not signed"
    OTHER_KEY = "are signed with another key"
    STALE = "were signed more than a minute ago by this computer's clock"
    REPLAYED = "were sent before"


class Signing:
    """A holder of a key at one link: signs the packets that it sends and judges the packets that it receives.

    Its time never goes back: it is the latest of `unix_s`, of the times it has signed or believed, and of `kept`.
    `keep` receives a time that is later than all times of the next 10 s.
    """

    def __init__(
        self,
        key: bytes,
        *,
        kept: int = 0,
        keep: Callable[[int], None] = lambda _: None,
        unix_s: Callable[[], float] = time.time,
        link: int = 0,
    ) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"a key for signing has {KEY_BYTES} bytes, not {len(key)}")
        self._key = key
        self._link = link
        self._unix_s = unix_s
        self._latest = self._kept = kept
        self._keep = keep
        self._heard: dict[tuple[int, int, int], int] = {}  # the time of a stream's last packet

    def pack(self, message: Any, codec: Any) -> bytes:
        """The message's bytes, signed, by the codec's system and sequence number."""
        self._advance(max(self._now(), self._latest + 1))
        codec.signing.secret_key, codec.signing.link_id = self._key, self._link
        codec.signing.timestamp, codec.signing.sign_outgoing = self._latest, True
        return bytes(message.pack(codec))

    def refusal(self, packet: bytes) -> SignatureRefusal | None:
        """Why the packet, which is whole, is not believed; None where it is, which makes it the stream's last."""
        if forgery := self.forgery(packet):
            return forgery
        link, made = packet[-_SIGNATURE_BYTES], int.from_bytes(packet[-12:-_HASH_BYTES], "little")
        stream = link, packet[5], packet[6]
        last = self._heard.get(stream)
        if last is not None and made <= last:
            return SignatureRefusal.REPLAYED
        if last is None and made + _NEW_STREAM_TICKS < max(self._now(), self._latest):
            return SignatureRefusal.STALE
        self._heard[stream] = made
        self._advance(made)
        return None

    def forgery(self, packet: bytes) -> SignatureRefusal | None:
        """Why the packet, which is whole, was not made by a holder of the key; None if it was, now or earlier."""
        if (
            len(packet) < _SHORTEST_BYTES
            or packet[0] != mavlink.PROTOCOL_MARKER_V2
            or not packet[2] & _SIGNED
        ):
            return SignatureRefusal.UNSIGNED
        signed = hashlib.sha256(self._key + packet[:-_HASH_BYTES]).digest()[:_HASH_BYTES]
        return None if hmac.compare_digest(signed, packet[-_HASH_BYTES:]) else SignatureRefusal.OTHER_KEY

    def _now(self) -> int:
        return min(_LATEST - 1, max(0, int((self._unix_s() - _EPOCH_UNIX_S) * TICKS_PER_S)))

    def _advance(self, to: int) -> None:
        self._latest = min(_LATEST, max(self._latest, to))
        if self._latest >= self._kept:
            self._kept = self._latest + _KEPT_AHEAD_TICKS
            self._keep(self._kept)


def key_of(data: bytes) -> bytes:
    """The key in a file's bytes: 32 bytes, or 64 hexadecimal digits on a line; raises ValueError."""
    if len(data) == KEY_BYTES:
        return data
    text = data.strip()
    if not re.fullmatch(rb"[0-9a-fA-F]{64}", text):
        raise ValueError("is no key for signing: it has to hold 32 bytes, or 64 hexadecimal digits")
    return bytes.fromhex(text.decode())


def key_of_passphrase(passphrase: str) -> bytes:
    """The key that ground stations make of a passphrase."""
    return hashlib.sha256(passphrase.encode()).digest()
