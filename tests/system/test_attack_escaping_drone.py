"""Control characters of a drone with a certificate, wherever a daemon takes text, reach neither log nor terminal."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import grpc
import msgspec
import pytest
from tests.programs import upwash
from tests.system.daemons import channel, config, daemon, shown

from upwash.real.trust.authority import make_keys
from upwash.rpc.protocol import AVAILABILITY, HOLD, LEAVE, PREPARE, START

pytestmark = pytest.mark.system

ESCAPES = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202edetsurt\u2066\r\nWARNING all is well"
SHOWN = r"\x1b[2J\x1b]0;owned\x07\x9b31m\u202edetsurt\u2066\r\nWARNING all is well"
REQUESTS: tuple[tuple[str, dict[str, Any]], ...] = (
    (AVAILABILITY, {"server": ESCAPES, "services": [ESCAPES]}),
    (AVAILABILITY, {"server": "s1", "services": [ESCAPES]}),
    (AVAILABILITY, {"server": "s1", "services": [], ESCAPES: 1}),
    (START, {"server": "s1", "service": ESCAPES}),
    (LEAVE, {"server": ESCAPES}),
    (PREPARE, {"server": "s1", "peer": ESCAPES, "services": [ESCAPES], "arrives_in_s": 1.0, "hold_s": 1.0}),
    (HOLD, {"server": "s1", "drone": ESCAPES, "certificate": ESCAPES, "services": [ESCAPES], "for_s": 1.0}),
    ("/upwash.Daemon/nothing\N{RIGHT-TO-LEFT OVERRIDE}".encode().decode("latin-1"), {}),
)


def unprintable(text: str) -> int:
    """How many characters of it are no text, ends of lines aside."""
    return sum(not each.isprintable() for each in text.replace("\n", ""))


def test_no_control_character_of_a_drone_reaches_a_log_or_a_terminal(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    make_keys(keys, servers=[["s1", "s2"]], drones=["heron"], operators=["operator"])
    with daemon(tmp_path, config(keys)) as at:
        with channel(at.address, shown(keys, "heron")) as heron:
            for path, body in REQUESTS:
                with contextlib.suppress(grpc.RpcError, ValueError, UnicodeError):
                    heron.unary_unary(path)(msgspec.msgpack.encode(body), timeout=5.0)
        told = upwash("status", at.address, "--server", "s1", "--keys", keys)
    logged = (tmp_path / "stderr").read_bytes().decode()
    assert f"no place for heron: no server {SHOWN} here" in logged
    assert "no server" in told.stdout
    assert unprintable(logged) == unprintable(told.stdout) == 0
