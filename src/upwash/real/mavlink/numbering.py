"""Which messages of a vehicle are news, and which come twice or late."""

from __future__ import annotations

from upwash.real.mavlink.hearing import Message

_LATE_BY = 64  # messages, about a second: what is older by its number comes from a restarted vehicle


class Numbering:
    """The sequence numbers of one vehicle's messages."""

    def __init__(self) -> None:
        self._newest: int | None = None  # the number of its last message

    def is_late(self, message: Message, *, linked: bool) -> bool:
        """Whether it was heard already, or is older than the newest; after a silence anything is news."""
        return self._newest is not None and linked and (self._newest - message.get_seq()) % 256 <= _LATE_BY

    def take(self, message: Message) -> None:
        """The message is the newest."""
        self._newest = message.get_seq()
