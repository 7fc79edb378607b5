"""A running daemon among strangers and bad drones: honest drones are served, its memory stays, its log says why."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import grpc
import pytest
from tests.system.daemons import channel, config, daemon
from tests.system.hostile import ATTACKS, attacked, attacked_site

from upwash.real.trust import authority as module
from upwash.real.trust.authority import keys_in, make_keys
from upwash.real.trust.credentials import Credentials
from upwash.rpc.protocol import AVAILABILITY

pytestmark = [pytest.mark.system, pytest.mark.long]

MOST_GROWN_BYTES = 30_000_000  # by strangers, and by one drone: docs/server-safety.md
MOST_GROWN_BY_ALL_BYTES = 80_000_000  # connections that the door has places for
CALLS = 10
REFUSALS = {  # what the daemon's log says of an attack that it can tell from an honest drone's doing
    "10 x 1 MB of random bytes": "refused 127.0.0.1: [A-Z_]+",
    "300 MB streamed without a certificate": "refused 127.0.0.1: [A-Z_]+",
    "lengths declared up to 2^62": "refused /upwash.Daemon/Availability to stork: undecodable request.*truncated",
    "requests that begin and never end": "refused /upwash.service.workbench/echo to stork: drone stork has no lease",
    "300 MB streamed by a drone": "refused /upwash.Daemon/Availability to stork: undecodable request",
}


@pytest.mark.parametrize("name", ATTACKS)
def test_an_honest_drone_is_served_during(name: str, tmp_path: Path, services: Path) -> None:
    text, keys = attacked_site(tmp_path)
    with daemon(tmp_path, text) as at:
        outcome = asyncio.run(attacked(at, keys, services, name, calls=CALLS))
        most_bytes = MOST_GROWN_BY_ALL_BYTES if "16 drones" in name else MOST_GROWN_BYTES
        assert outcome.grown_bytes <= most_bytes
        if name in REFUSALS:
            at.has_said(REFUSALS[name])


# --- certificates -------------------------------------------------------------------------------------------


def expired(keys: Path, monkeypatch: pytest.MonkeyPatch) -> Credentials:
    monkeypatch.setattr(module, "_CLOCKS_MAY_DIFFER", timedelta(days=10))
    monkeypatch.setattr(module, "_CERTIFICATE_LASTS", timedelta(days=-3))
    make_keys(keys, drones=["expired"])
    files = keys_in(keys, "expired")  # which read_credentials refuses
    return Credentials(*(file.read_bytes() for file in (files.authority, files.certificate, files.key)))


def none(keys: Path, _: pytest.MonkeyPatch) -> Credentials:
    return Credentials((keys / "authority.pem").read_bytes(), b"", b"")


@pytest.mark.parametrize(
    ("who", "reason"),
    [
        (none, "PEER_DID_NOT_RETURN_A_CERTIFICATE"),
        (expired, "CERTIFICATE_VERIFY_FAILED.*certificate has expired"),
    ],
)
def test_a_certificate_that_is_not_a_drones_is_refused_and_the_log_says_why(
    who: Callable[[Path, pytest.MonkeyPatch], Credentials],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keys = tmp_path / "keys"
    make_keys(keys, servers=[["s1", "s2"]])
    shows = who(keys, monkeypatch)
    with daemon(tmp_path, config(keys)) as at:
        with channel(at.address, shows) as opened, pytest.raises(grpc.RpcError) as refusal:
            opened.unary_unary(AVAILABILITY)(b"", timeout=10.0)
        assert refusal.value.code() is grpc.StatusCode.UNAVAILABLE
        at.has_said(f"refused 127.0.0.1: {reason}")
