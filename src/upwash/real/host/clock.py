"""The computer's clock, set from the autopilot's GPS if nothing else keeps it; certificates are valid by this clock.

A computer without a battery-backed clock starts with the time of its last shutdown, or of its image.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time
from datetime import UTC, datetime

from upwash.core.vehicle.telemetry import gps_time
from upwash.errors import CredentialsError
from upwash.eventlog import schema
from upwash.ports import Journal
from upwash.real.trust.credentials import Credentials, at_second
from upwash.support.text import command

_WRONG_S = 60.0  # TLS compares seconds, but certificates last years; a GPS without leap seconds is 18 s off
_STA_UNSYNC = 0x40  # of adjtimex(2): nothing keeps the clock in time
_PR_CAP_AMBIENT, _PR_CAP_AMBIENT_CLEAR_ALL = 47, 4  # of prctl(2)


class SystemClock:
    """This computer's clock; tests replace it."""

    def now_s(self) -> float:
        """Seconds since 1970 by the system's clock, which TLS uses too."""
        return time.time()

    def is_kept(self) -> bool:
        """Whether a program, such as NTP, keeps the clock in time, as the kernel reports."""
        status = _adjtimex_status()
        return status is not None and not status & _STA_UNSYNC

    def set(self, unix_s: float) -> None:
        """Sets the clock of the whole computer; raises OSError without CAP_SYS_TIME."""
        time.clock_settime(time.CLOCK_REALTIME, unix_s)


SYSTEM_CLOCK = SystemClock()


def agree_on_time(
    gps_unix_s: float | None, credentials: Credentials, journal: Journal, *, clock: SystemClock = SYSTEM_CLOCK
) -> None:
    """Sets a wrong clock to the GPS's time; raises CredentialsError if the certificates are not valid afterwards.

    A clock that NTP or another program keeps, or that this process may not set, stays as it is. The clock is never
    set to a time outside the certificates' validity, so that a forged time cannot make other certificates valid.
    """
    if gps_unix_s is None or gps_time(gps_unix_s) is None:
        remedy = _remedy()
        why = f"; the vehicle's GPS does not tell the time yet: wait for its fix and start again, or {remedy}"
    else:
        why = _set_if_wrong(gps_unix_s, credentials, journal, clock)
    if problem := problem_by(clock, credentials):
        raise CredentialsError(f"{problem}{why}")


def problem_by(clock: SystemClock, credentials: Credentials) -> str:
    """Which certificate is not valid by the clock, with its dates; "" if all are."""
    return credentials.problem_at(_datetime(clock.now_s()))


def keep_right_from_services() -> None:
    """Drops the right to set the clock, and every other capability, for child processes such as services."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_CAP_AMBIENT, _PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)


def _set_if_wrong(gps_unix_s: float, credentials: Credentials, journal: Journal, clock: SystemClock) -> str:
    """Set a wrong clock; return the remedy for a certificate that is not valid afterwards."""
    now_s = clock.now_s()
    before, gps = at_second(_datetime(now_s)), at_second(_datetime(gps_unix_s))
    if abs(gps_unix_s - now_s) <= _WRONG_S:
        return ", and the vehicle's GPS agrees: make a new certificate"
    if clock.is_kept():
        why_not = "something keeps this computer's clock in time, such as NTP"
    elif problem := credentials.problem_at(_datetime(gps_unix_s), by="the vehicle's GPS"):
        raise CredentialsError(
            f"{problem}; this computer's clock says {before} and was not set: make a new certificate, or wait until "
            "the GPS is right"
        )
    else:
        try:
            clock.set(gps_unix_s)
        except OSError as error:
            why_not = f"this program may not set the clock ({error.strerror})"
        else:
            journal.record(schema.ClockSet(before=_datetime(now_s), after=_datetime(gps_unix_s)))
            return ", as it was set from the vehicle's GPS: make a new certificate"
    journal.record(schema.ClockDiffers(clock=before, gps=gps, why=why_not))
    return f"; the vehicle's GPS says {gps}, but {why_not}: {_remedy()}"


def _remedy() -> str:
    again = [sys.executable, *sys.orig_argv[1:]]
    with_the_right = ("--pty", "--same-dir", f"--uid={os.getuid()}", "-p", "AmbientCapabilities=CAP_SYS_TIME")
    return (
        "have a battery-backed clock, or chrony with gpsd, keep this computer's clock; or let upwash set it: "
        "AmbientCapabilities=CAP_SYS_TIME in the [Service] of its systemd unit, or "
        + command("sudo", "systemd-run", *with_the_right, *again)
    )


def _datetime(unix_s: float) -> datetime:
    return datetime.fromtimestamp(unix_s, UTC)


class _Timex(ctypes.Structure):
    """The start of the kernel's struct timex; the rest is only kept free."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 512),
    )


def _adjtimex_status() -> int | None:
    """The status bits of the kernel's clock, which is not changed; None if they cannot be read."""
    timex = _Timex()
    try:
        answer = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    except (OSError, AttributeError):
        return None
    return None if answer < 0 else int(timex.status)
