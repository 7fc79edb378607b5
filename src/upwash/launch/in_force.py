"""What of an operator's orders a daemon has in force, since when, and what the last reload refused."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from datetime import UTC, datetime

from msgspec.structs import replace

from upwash.launch.daemon_keys import DaemonKeys
from upwash.real.host.clock import SYSTEM_CLOCK, SystemClock
from upwash.real.trust.credentials import at_second
from upwash.rpc.protocol import DaemonStatus, PartStatus, ReloadStatus
from upwash.support.software import software
from upwash.support.text import printable

REVOCATIONS, KEYS, CONFIGURATION = "revocations", "keys", "configuration"
_SHOWN_DIGITS = 12


def service_part(name: str) -> str:
    """The part that is the code and files of a service."""
    return f"service {name}"


class InForce:
    """The parts of the orders by their names; `code` is the digest of upwash, `now` the clock of the status."""

    def __init__(
        self,
        keys: DaemonKeys,
        *,
        code: str,
        sandbox: str,
        clock: SystemClock = SYSTEM_CLOCK,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._keys = keys
        self._code = code
        self._sandbox = sandbox
        self._clock = clock
        self._now = now
        self._parts: dict[str, PartStatus] = {}
        self._reload: ReloadStatus | None = None

    def begin_reload(self, by: str) -> None:
        """Note that `by` has asked for a reload, which is under way."""
        self._reload = ReloadStatus(self._now(), printable(by))

    def end_reload(self) -> None:
        """Note that the reload is over."""
        if self._reload is not None:
            self._reload = replace(self._reload, ended=self._now())

    def take(self, part: str, digest: str) -> None:
        """Note what is in force of a part now; the same digest is in force since before."""
        known = self._parts.get(part)
        since = known.since if known is not None and known.digest == digest else self._now()
        self._parts[part] = PartStatus(digest, since)

    def refuse(self, part: str, why: str) -> None:
        """Note why the part stays as it is."""
        known = self._parts.get(part) or PartStatus("", self._now())
        self._parts[part] = replace(known, refused=printable(why))

    def forget_services_but(self, names: Collection[str]) -> None:
        """Note that the daemon offers these services only."""
        parts = {REVOCATIONS, KEYS, CONFIGURATION, *map(service_part, names)}
        self._parts = {part: status for part, status in self._parts.items() if part in parts}

    @property
    def refused(self) -> dict[str, str]:
        """Why each part stays as it is that the last reload refused."""
        return {part: status.refused for part, status in self._parts.items() if status.refused}

    def status(self) -> DaemonStatus:
        """All of it, for operators."""
        known = software()
        return DaemonStatus(
            version=known.version,
            commit=known.commit,
            code=self._code,
            sandbox=self._sandbox,
            time=self._now(),
            clock_is_kept=self._clock.is_kept(),
            revoked=len(self._keys.revoked),
            parts=self._parts,
            reload=self._reload,
        )

    def first_line(self) -> str:
        """Which program runs with what, for the beginning of a log."""
        return "; ".join(self._facts())

    def _facts(self) -> Iterator[str]:
        status = self.status()
        commit = f" (commit {status.commit[:_SHOWN_DIGITS]})" if status.commit else ""
        yield f"upwash {status.version}{commit}, code {self._code[:_SHOWN_DIGITS]}, sandbox: {self._sandbox}"
        for part, in_force in self._parts.items():
            if in_force.digest:
                yield f"{part} {in_force.digest[:_SHOWN_DIGITS]}"
        yield revoked_now(status.revoked)
        for certificate in self._keys.certificates:
            yield f"the certificate of {certificate.holder} ends on {at_second(certificate.expires)}"
        yield f"the clock says {at_second(status.time)}, and {clock_state(status)}"


def revoked_now(count: int) -> str:
    """How many certificates are revoked, as the log and the status have it."""
    return f"{count} certificates are revoked"


def clock_state(status: DaemonStatus) -> str:
    """Whether a program keeps the daemon's clock in time."""
    kept = {True: "is kept in time", False: "nothing keeps it in time", None: "it is unknown what keeps it"}
    return kept[status.clock_is_kept]
