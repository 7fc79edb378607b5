"""Handles requests, over gRPC and over a socket pair: admits them, has them answered, and bounds both."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from upwash.core.admission.clients import Client
from upwash.errors import DeadlineExceeded, Refused, UpwashError
from upwash.real.host.log import RateLimitedLog
from upwash.support.text import counted, printable

_log = logging.getLogger("upwash.listener")
_log.addFilter(RateLimitedLog())


@dataclass(frozen=True, slots=True)
class Caller:
    """The sender of a request, the seconds left for its answer, if known, and whether the sender still waits.

    A call need not begin after `may_queue_s`; None: it waits for any time.
    """

    client: Client
    time_left_s: Callable[[], float | None]
    is_waiting: Callable[[], bool]
    may_queue_s: float | None = None


Handler = Callable[[str, bytes, Caller], bytes]
Gate = Callable[[str, Caller], None]


class Requests:
    """Has `handler` answer requests, at most `concurrent` at a time and `per_drone` for one drone; refuses others.

    `gate` may refuse a request before its body is received, so that a refused caller takes no memory.
    """

    def __init__(
        self,
        handler: Handler,
        *,
        max_message_bytes: int,
        concurrent: int,
        per_drone: int,
        gate: Gate = lambda _path, _caller: None,
    ) -> None:
        self.max_message_bytes = max_message_bytes
        self.concurrent = concurrent
        self._per_drone = per_drone
        self._handler = handler
        self._gate = gate
        self._counting = threading.Lock()
        self._under_way: Counter[str] = Counter()

    def answer(self, path: str, caller: Caller, receive: Callable[[], bytes]) -> bytes:
        """The reply to the body that `receive` returns; raises UpwashError with what the caller may read.

        Any other error is a defect of the handler: it is logged, and the caller gets a general text.
        """
        try:
            with self._counted(caller.client.key):
                self._gate(path, caller)
                reply = self._handler(path, receive(), caller)
                if len(reply) > self.max_message_bytes:
                    whose = "the computer that runs the service"
                    raise Refused(too_large("result", len(reply), self.max_message_bytes, whose=whose))
                return reply
        except (Refused, DeadlineExceeded) as refusal:
            name = caller.client.name or "an unnamed caller"
            _log.warning("refused %s to %s: %s", path, name, printable(str(refusal)), extra={"whom": name})
            raise
        except UpwashError:
            raise
        except BaseException:
            _log.exception("%s by %s failed", path, caller.client.name)
            raise

    @contextlib.contextmanager
    def _counted(self, drone: str) -> Iterator[None]:
        with self._counting:
            if self._under_way.total() >= self.concurrent:
                raise Refused(f"{counted(self.concurrent, 'request')} under way already")
            if self._under_way[drone] >= self._per_drone:
                raise Refused(f"this drone has {counted(self._per_drone, 'request')} under way already")
            self._under_way[drone] += 1
        try:
            yield
        finally:
            with self._counting:
                self._under_way[drone] -= 1
                if not self._under_way[drone]:
                    del self._under_way[drone]


def words_for_caller(error: BaseException) -> str:
    """The text for a caller about an error of `Requests.answer`, without details of a defect."""
    return printable(str(error)) if isinstance(error, UpwashError) else "the server failed; its log says why"


def too_large(what: str, size: int, most: int, *, whose: str, key: str = "max_message_bytes") -> str:
    """The text that refuses a request or result of that size, with the remedy in the configuration of `whose`."""
    return (
        f"the {what} has {size} bytes, more than {key} = {most}: make it smaller, or raise that in the "
        f"configuration of {whose}"
    )
