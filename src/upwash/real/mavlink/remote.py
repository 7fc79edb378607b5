"""Whether the pilot's remote control has just moved, by what the vehicle reports of its channels."""

from __future__ import annotations

import math

from upwash.real.mavlink.hearing import Message

_MOVES_US = 50  # of a channel's pulse; less is noise
_JUST_S = 1.5  # a mode is reported so much later at most
_FRESH_S = 2.0  # an older report says nothing of now
_CHANNELS = 18
_UNUSED_US = (0, 0xFFFF)


class RemoteControl:
    """Follows the channels of RC_CHANNELS."""

    def __init__(self) -> None:
        self._channels_us: tuple[int, ...] = ()  # as they were when one last moved
        self._heard_s = self._moved_s = -math.inf

    def take(self, message: Message, now_s: float) -> None:
        """Takes in a report; one without channels is of a vehicle that hears no remote control."""
        if not message.chancount:
            self._channels_us = ()
            return
        now_us = tuple(getattr(message, f"chan{number}_raw") for number in range(1, _CHANNELS + 1))
        self._heard_s = now_s
        if not self._channels_us:
            self._channels_us = now_us
        elif any(
            abs(after - before) >= _MOVES_US
            for before, after in zip(self._channels_us, now_us, strict=True)
            if before not in _UNUSED_US and after not in _UNUSED_US
        ):
            self._channels_us, self._moved_s = now_us, now_s

    def moved(self, now_s: float) -> bool | None:
        """Whether a stick or switch has just moved; None where nothing is known of now."""
        if not self._channels_us or now_s - self._heard_s > _FRESH_S:
            return None
        return now_s - self._moved_s <= _JUST_S
