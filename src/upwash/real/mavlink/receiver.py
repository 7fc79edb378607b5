"""Which bytes of a connection are accepted: by signature and, on a port to which anyone may send, by address."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message, PacketReader
from upwash.mavlink.signing import SignatureRefusal, Signing

Address: TypeAlias = tuple[Any, ...]  # host and port, and more with IPv6

_LONGEST_INTRODUCTION_BYTES = 2048  # no router sends longer datagrams
_OVERHEARD_EACH_S = 0.05
# The header of an autopilot's heartbeat: looking for it costs a thousandth of reading nonsense.
_HEARTBEAT = re.compile(rb"\xfd\x09[\x00\x01]...\x01\x00\x00\x00|\xfe\x09..\x01\x00", re.DOTALL)


def from_autopilot(message: Message) -> bool:
    """Whether the message is an autopilot's heartbeat."""
    if message.get_type() != "HEARTBEAT" or message.get_srcSystem() == 0:
        return False
    flies = message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    return bool(flies and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1)


def is_signed(message: Message) -> bool:
    """Whether the message has a signature, valid or not."""
    return bool(message.get_header().incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED)


class MessageReceiver:
    """Passes accepted messages to `heard`; `refused` is why an autopilot's last heartbeat was not accepted.

    `follows` recognizes the vehicle's heartbeat. `overheard` gets the messages of other senders.
    """

    def __init__(
        self,
        heard: Callable[[Message], object],
        follows: Callable[[Message], bool],
        signing: Signing | None,
        overheard: Callable[[Message], object] = lambda _: None,
    ) -> None:
        self.refused: SignatureRefusal | None = None
        self._heard = heard
        self._follows = follows
        self._overheard = overheard
        self._signing = signing

    def reader(self) -> PacketReader:
        """A reader for one stream."""
        return PacketReader(self._signing)

    def take(self, data: bytes, reader: PacketReader | None = None) -> bool:
        """Pass on the messages in the bytes of a stream, or in a datagram; return whether any was accepted.

        A datagram has whole messages. It is read by itself, so that a broken datagram cannot affect the next.
        """
        messages, _ = self._judged(data, reader or self.reader())
        return self._pass_on(messages)

    def meet(self, data: bytes) -> tuple[bool, bool]:
        """Pass on a datagram of an unknown sender only if it contains the vehicle's heartbeat.

        Returns whether it was passed on, and whether a holder of the key signed an autopilot's heartbeat in it.
        """
        messages, has_key = self._judged(data, self.reader())
        if any(self._follows(message) for message in messages):
            return self._pass_on(messages), has_key
        for message in messages:
            self._overheard(message)
        return False, has_key

    def overhear(self, data: bytes) -> None:
        """Note the autopilots in a datagram from another address; with a key, only those that have the key."""
        for message, _ in PacketReader().read(data):
            packet = bytes(message.get_msgbuf())
            if self._signing is None or self._signing.forgery(packet) is None:
                self._overheard(message)

    def _pass_on(self, messages: list[Message]) -> bool:
        for message in messages:
            self._heard(message)
        return bool(messages)

    def _judged(self, data: bytes, reader: PacketReader) -> tuple[list[Message], bool]:
        """The accepted messages, and whether an autopilot's heartbeat was refused only for its age."""
        read = reader.read(data)
        late = False
        for message, refusal in read:
            if from_autopilot(message):
                self.refused = refusal
                late |= refusal is SignatureRefusal.STALE
        return [message for message, refusal in read if refusal is None], late


class Peer:
    """The one address from which an open UDP port accepts datagrams, and to which it answers.

    It is the address of the vehicle's first heartbeat. After `moved_after_s` without an accepted message, as when a
    router restarts, the vehicle's heartbeat from another port of the same host makes that port the peer; if messages
    are signed, from any host. Without signatures the first sender is accepted, and every sender that uses the peer's
    address.
    """

    def __init__(self, receiver: MessageReceiver, *, moved_after_s: float, signed: bool) -> None:
        self.address: Address | None = None
        self.ignored = 0  # datagrams of others
        self.last_ignored: Address | None = None
        self._receiver = receiver
        self._moved_after_s = moved_after_s
        self._signed = signed
        self._heard_s: float  # when the peer's last accepted message came
        self._overheard_s = -math.inf
        self._late: Address | None = None  # of a vehicle with outdated signatures, while there is no peer

    @property
    def answered(self) -> Address | None:
        """The address to which to send; None while there is none.

        A vehicle without GPS may sign with the time of its last flight. It adopts our time once it receives our
        heartbeat, and is accepted from then on. So a heartbeat, and nothing else, is sent before there is a peer.
        """
        return self.address or self._late

    def take(self, data: bytes, address: Address, now_s: float) -> None:
        """Take in the peer's datagram, or make the sender of the vehicle's heartbeat the peer; ignore all others."""
        if address == self.address:
            if self._receiver.take(data):
                self._heard_s = now_s
        elif self._may_be(address, now_s) and _may_introduce(data):
            self._meet(data, address, now_s)
        else:
            self._ignore(address)
            self._overhear(data, now_s)

    def _may_be(self, address: Address, now_s: float) -> bool:
        if self.address is None:
            return True
        silent = now_s - self._heard_s > self._moved_after_s
        return silent and (self._signed or address[0] == self.address[0])

    def _meet(self, data: bytes, address: Address, now_s: float) -> None:
        is_vehicle, has_key = self._receiver.meet(data)
        if is_vehicle:
            self.address, self._heard_s = address, now_s
        elif has_key:
            self._late = address
        else:
            self._ignore(address)

    def _overhear(self, data: bytes, now_s: float) -> None:
        """Note another vehicle at another address, at a bounded rate."""
        if now_s - self._overheard_s >= _OVERHEARD_EACH_S and _may_introduce(data):
            self._overheard_s = now_s
            self._receiver.overhear(data)

    def _ignore(self, address: Address) -> None:
        self.ignored += 1
        self.last_ignored = address


def _may_introduce(data: bytes) -> bool:
    return len(data) <= _LONGEST_INTRODUCTION_BYTES and _HEARTBEAT.search(data) is not None
