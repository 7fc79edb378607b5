"""What every contender does with a request: says how long it was, in 100 bytes."""

from __future__ import annotations

from upwash.rpc.service import service

REPLY_BYTES = 100


def answer(request: bytes) -> bytes:
    """The reply to a request: its length, padded to 100 bytes."""
    return b"%*d" % (REPLY_BYTES, len(request))


@service
class Echo:
    """The service that a server runs for the drone."""

    def measure(self, photo: bytes) -> bytes:
        """The photo's length, in 100 bytes."""
        return answer(photo)


@service
class OnboardEcho(Echo):
    """The same for the drone alone: no server is believed to run it, so that each call stays local."""
