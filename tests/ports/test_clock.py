"""The computer's clock and the vehicle's GPS: a clock of the tests' own is set, never this machine's."""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from tests.events import written

from upwash.config.drone_file import drone_config
from upwash.core.geo import GeoPosition
from upwash.errors import CredentialsError
from upwash.launch import flight as launch
from upwash.real.host.clock import SystemClock, agree_on_time
from upwash.real.host.journal import FileJournal, read_events
from upwash.real.trust.credentials import Credentials
from upwash.sim.journal import MemoryJournal
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.server import serve_vehicle

STALE_S = datetime(2025, 6, 1, tzinfo=UTC).timestamp()  # before the certificates of the tests


@dataclass
class OwnClock(SystemClock):
    """Stands still until it is set."""

    says_s: float
    kept: bool = False
    may: bool = True
    was_set: list[float] = field(default_factory=list)

    def now_s(self) -> float:
        return self.says_s

    def is_kept(self) -> bool:
        return self.kept

    def set(self, unix_s: float) -> None:
        if not self.may:
            raise PermissionError(1, "Operation not permitted")
        self.was_set.append(unix_s)
        self.says_s = unix_s


def agreed(gps_unix_s: float | None, credentials: Credentials, clock: OwnClock) -> list[dict[str, Any]]:
    """What is logged while the two agree."""

    async def agree() -> list[dict[str, Any]]:
        journal = MemoryJournal()
        journal.begin()
        agree_on_time(gps_unix_s, credentials, journal, clock=clock)
        return written(journal.events)

    return run_virtually(agree())


Holder = Callable[[str], Credentials]


def test_a_stale_clock_is_set_where_that_is_allowed(credentials: Holder) -> None:
    now_s = time.time()
    clock = OwnClock(STALE_S)
    (event,) = agreed(now_s, credentials("heron"), clock)
    assert clock.was_set == [now_s]
    assert event["event"] == "clock_set"
    assert datetime.fromisoformat(event["before"]) == datetime(2025, 6, 1, tzinfo=UTC)
    assert datetime.fromisoformat(event["after"]).timestamp() == pytest.approx(now_s)


@pytest.mark.parametrize("wrong_s", [-59.0, 0.0, 59.0])
def test_a_clock_that_is_right_is_left_as_it_is(credentials: Holder, wrong_s: float) -> None:
    clock = OwnClock(time.time() + wrong_s)
    assert agreed(time.time(), credentials("heron"), clock) == []
    assert clock.was_set == []


def test_a_clock_that_is_ahead_is_set_back(credentials: Holder) -> None:
    clock = OwnClock(time.time() + 10 * 365 * 86_400)
    agreed(time.time(), credentials("heron"), clock)
    assert len(clock.was_set) == 1


def test_a_clock_that_something_keeps_is_believed_rather_than_the_gps(credentials: Holder) -> None:
    clock = OwnClock(time.time(), kept=True)
    (event,) = agreed(time.time() - 3600.0, credentials("heron"), clock)
    assert event["event"] == "clock_differs" and "such as NTP" in event["why"]
    assert clock.was_set == []


def test_a_stale_clock_that_may_not_be_set_is_refused_with_its_dates_and_the_remedy(
    credentials: Holder,
) -> None:
    heron = credentials("heron")
    with pytest.raises(CredentialsError) as refused:
        agreed(time.time(), heron, OwnClock(STALE_S, may=False))
    said = str(refused.value)
    starts = x509.load_pem_x509_certificate(heron.certificate).not_valid_before_utc
    assert said.startswith(
        f"the certificate of heron is not valid yet: it is valid from {starts:%Y-%m-%d %H:%M:%S} UTC"
    )
    assert "this computer's clock says 2025-06-01 00:00:00 UTC; the vehicle's GPS says 20" in said
    assert "may not set the clock (Operation not permitted)" in said
    assert "AmbientCapabilities=CAP_SYS_TIME" in said and "chrony with gpsd" in said


def test_a_wrong_clock_that_may_not_be_set_is_said_where_the_certificates_are_valid_all_the_same(
    credentials: Holder,
) -> None:
    (event,) = agreed(time.time() + 7200.0, credentials("heron"), OwnClock(time.time(), may=False))
    assert event["event"] == "clock_differs" and "may not set the clock" in event["why"]


@pytest.mark.parametrize("gps_unix_s", [None, 0.5, datetime(2006, 4, 7, tzinfo=UTC).timestamp(), 2**64 / 1e6])
def test_without_a_time_from_the_gps_the_clock_is_judged_as_it_is(
    credentials: Holder, gps_unix_s: float | None
) -> None:
    """19.6 years back is where a receiver is that has lost count of its weeks."""
    assert agreed(gps_unix_s, credentials("heron"), OwnClock(time.time())) == []
    stale = OwnClock(STALE_S)
    with pytest.raises(
        CredentialsError, match=r"heron is not valid yet.*GPS does not tell the time yet: wait"
    ):
        agreed(gps_unix_s, credentials("heron"), stale)
    assert stale.was_set == []


def test_a_certificate_that_is_outdated_by_both_is_to_be_made_anew(credentials: Holder) -> None:
    later_s = time.time() + 3 * 365 * 86_400
    for clock in OwnClock(later_s), OwnClock(STALE_S):
        with pytest.raises(CredentialsError, match=r"heron has expired.*make a new certificate"):
            agreed(later_s, credentials("heron"), clock)


@pytest.mark.parametrize("forged_s", [STALE_S, datetime(2059, 1, 1, tzinfo=UTC).timestamp()])
def test_a_forged_time_sets_no_clock_where_the_certificates_are_not_valid_then(
    credentials: Holder, forged_s: float
) -> None:
    """An expired certificate that somebody stole would be valid again, and the clock wrong for good."""
    clock = OwnClock(time.time())
    with pytest.raises(
        CredentialsError, match=r"the vehicle's GPS says .* this computer's clock .* was not set"
    ):
        agreed(forged_s, credentials("heron"), clock)
    assert clock.was_set == []


def test_this_computers_clock_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, float]] = []
    monkeypatch.setattr(time, "clock_settime", lambda clock, to_s: asked.append((clock, to_s)))
    clock = SystemClock()
    assert clock.now_s() == pytest.approx(time.time(), abs=5.0)
    assert isinstance(clock.is_kept(), bool)
    clock.set(1.5)
    assert asked == [(time.CLOCK_REALTIME, 1.5)]


async def test_a_flight_that_is_taken_up_counts_from_when_the_clock_was_set(tmp_path: Path) -> None:
    """The time of day at which the log was opened was wrong by months."""
    log = tmp_path / "events.jsonl"
    now = datetime.now(UTC).isoformat()
    log.write_text(
        '{"t": 0.0, "event": "log_opened", "time": "2025-06-01T00:00:00+00:00"}\n'
        f'{{"t": 30.0, "event": "clock_set", "before": "2025-06-01T00:00:30+00:00", "after": "{now}"}}\n'
    )

    FileJournal(log, resumes=True).close()
    assert 30.0 <= read_events(log)[-1].t < 90.0


# --- a whole flight -----------------------------------------------------------------------------------------

HOME = GeoPosition(39.3666, 22.9507)
MISSION = """
def hop(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(2)
    drone.autopilot.land()
    drone.autopilot.disarm()
"""


def hop(
    folder: Path,
    keys: Path,
    clock: OwnClock,
    *,
    clock_offset_s: float | None = 0.0,
    armable_after_s: float = 0.5,
) -> list[dict[str, Any]]:
    """Flies it with a stand-in in this process; its log."""
    (folder / "photos").mkdir()
    (folder / "photos" / "1.jpg").write_bytes(b"\xff\xd8")
    (folder / "hop.py").write_text(MISSION)
    log = folder / "events.jsonl"

    async def fly() -> None:
        agile = VehicleSettings(
            home=HOME,
            acceleration_m_s2=300.0,
            climb_m_s=100.0,
            descent_m_s=100.0,
            armable_after_s=armable_after_s,
            auto_disarm_s=0.2,
            clock_offset_s=clock_offset_s,
        )
        vehicle = await serve_vehicle("udp:127.0.0.1:0", agile)
        document = {
            "name": "heron",
            "mission": {
                "program": f"{folder}/hop.py:hop",
                "home": {"latitude_deg": HOME.latitude_deg, "longitude_deg": HOME.longitude_deg},
                "waypoints_m": [[0, 0]],
            },
            "autopilot": {"connection": vehicle.address.replace("udp:", "udpout:")},
            "camera": {"folder": f"{folder}/photos"},
            "keys": {
                "authority": f"{keys}/authority.pem",
                "certificate": f"{keys}/heron.pem",
                "key": f"{keys}/heron.key",
            },
        }
        try:
            await launch.fly(drone_config(document, folder / "drone.toml"), log=log, clock=clock)
        finally:
            await vehicle.close()

    try:
        asyncio.run(fly())
    finally:
        events = written(read_events(log))
    return events


def test_a_flight_sets_its_stale_clock_before_it_takes_off(tmp_path: Path, keys: Path) -> None:
    now_s, clock = time.time(), OwnClock(STALE_S)
    events = hop(tmp_path, keys, clock, armable_after_s=12.0)
    names = [event["event"] for event in events]
    assert names.index("waiting_for_the_time") < names.index("clock_set") < names.index("took_off")
    assert names[-1] == "mission_completed"
    assert clock.says_s == pytest.approx(now_s, abs=60.0)


def test_a_flight_with_a_stale_clock_that_may_not_be_set_stays_on_the_ground(
    tmp_path: Path, keys: Path
) -> None:
    with pytest.raises(CredentialsError, match=r"certificate of heron is not valid yet.*CAP_SYS_TIME"):
        hop(tmp_path, keys, OwnClock(STALE_S, may=False))
    assert "armed" not in [event.kind for event in read_events(tmp_path / "events.jsonl")]


def test_a_vehicle_without_the_time_holds_up_nothing_where_the_certificates_are_valid(
    tmp_path: Path, keys: Path
) -> None:
    events = hop(tmp_path, keys, OwnClock(time.time()), clock_offset_s=None)
    assert events[-1]["event"] == "mission_completed"
    assert not {"clock_set", "clock_differs", "waiting_for_the_time"} & {event["event"] for event in events}


@pytest.mark.skipif(os.getuid() != 0 or shutil.which("setpriv") is None, reason="needs root and setpriv")
def test_what_a_flight_starts_does_not_inherit_the_right_to_set_the_clock() -> None:
    script = (
        "import subprocess\n"
        "from upwash.real.host.clock import keep_right_from_services\n"
        "child = ['grep', 'CapAmb', '/proc/self/status']\n"
        "subprocess.run(child, check=True)\n"
        "keep_right_from_services()\n"
        "subprocess.run(child, check=True)\n"
    )
    granted = ["setpriv", "--reuid=65534", "--inh-caps=+sys_time", "--ambient-caps=+sys_time"]
    done = subprocess.run(
        [*granted, sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        pytest.skip(f"no capability can be given here: {done.stderr.strip()}")
    before, after = (int(line.split()[1], 16) for line in done.stdout.splitlines())
    assert before & 1 << 25  # CAP_SYS_TIME
    assert after == 0
