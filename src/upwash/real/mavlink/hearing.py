"""What is believed of the bytes that a connection brings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import PacketReader
from upwash.mavlink.signing import Refusal, Signing

Message: TypeAlias = Any  # pymavlink's messages are not typed


def from_autopilot(message: Message) -> bool:
    """Whether it is the heartbeat of an autopilot."""
    if message.get_type() != "HEARTBEAT" or message.get_srcSystem() == 0:
        return False
    flies = message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
    return bool(flies and message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1)


def is_signed(message: Message) -> bool:
    """Whether it has a signature, right or wrong."""
    return bool(message.get_header().incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED)


class Hearing:
    """Passes on the messages that are believed, and knows why an autopilot's last heartbeat was not."""

    def __init__(
        self,
        heard: Callable[[Message], None],
        follows: Callable[[Message], bool],
        signing: Signing | None,
        overheard: Callable[[Message], None] = lambda _: None,
    ) -> None:
        self.refused: Refusal | None = None
        self._heard = heard
        self._follows = follows
        self._overheard = overheard
        self._signing = signing

    def reader(self) -> PacketReader:
        """For one stream."""
        return PacketReader(self._signing)

    def take(self, data: bytes, reader: PacketReader | None = None) -> bool:
        """Passes on what the bytes of a stream hold, or a datagram; whether anything was believed.

        A datagram holds whole messages: read by itself, a broken one cannot spoil the next.
        """
        messages, _ = self._judged(data, reader or self.reader())
        return self._pass_on(messages)

    def meet(self, data: bytes) -> tuple[bool, bool]:
        """The same where the vehicle's heartbeat is in a datagram of nobody known, and else nothing.

        Whether it was passed on; and whether it was not, but an autopilot's heartbeat was signed by who has the key.
        """
        messages, has_key = self._judged(data, self.reader())
        if any(self._follows(message) for message in messages):
            return self._pass_on(messages), True
        for message in messages:
            self._overheard(message)
        return False, has_key

    def overhear(self, data: bytes) -> None:
        """Notes the autopilots in a datagram of another address; with a key, only those that have the key."""
        for message, _ in PacketReader().read(data):
            packet = bytes(message.get_msgbuf())
            if self._signing is None or self._signing.forgery(packet) is None:
                self._overheard(message)

    def _pass_on(self, messages: list[Message]) -> bool:
        for message in messages:
            self._heard(message)
        return bool(messages)

    def _judged(self, data: bytes, reader: PacketReader) -> tuple[list[Message], bool]:
        """What is believed, and whether an autopilot's heartbeat is not, for no more than its age."""
        read = reader.read(data)
        late = False
        for message, refusal in read:
            if from_autopilot(message):
                self.refused = refusal
                late |= refusal is Refusal.STALE
        return [message for message, refusal in read if refusal is None], late
