"""A drone with a certificate that puts control characters wherever a daemon takes text.

python -m tests.system.attacks.escaping_drone        says how many reach the daemon's log and an operator's terminal
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
from pathlib import Path
from typing import Any

import grpc
import msgspec
from tests.programs import upwash
from tests.system.daemons import channel, config, daemon, shown

from upwash.real.trust.authority import make_keys
from upwash.rpc.protocol import AVAILABILITY, HOLD, LEAVE, PREPARE, START

ESCAPES = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202edetsurt\u2066\r\nWARNING all is well"
_REQUESTS: tuple[tuple[str, dict[str, Any]], ...] = (
    (AVAILABILITY, {"server": ESCAPES, "services": [ESCAPES]}),
    (AVAILABILITY, {"server": "s1", "services": [ESCAPES]}),
    (AVAILABILITY, {"server": "s1", "services": [], ESCAPES: 1}),
    (START, {"server": "s1", "service": ESCAPES}),
    (LEAVE, {"server": ESCAPES}),
    (PREPARE, {"server": "s1", "peer": ESCAPES, "services": [ESCAPES], "arrives_in_s": 1.0, "hold_s": 1.0}),
    (HOLD, {"server": "s1", "drone": ESCAPES, "certificate": ESCAPES, "services": [ESCAPES], "for_s": 1.0}),
    ("/upwash.Daemon/nothing\N{RIGHT-TO-LEFT OVERRIDE}".encode().decode("latin-1"), {}),
)


def attacked(folder: Path) -> tuple[str, str]:
    """A daemon's log, and what `upwash status` prints of it, after a drone has sent all of that."""
    keys = folder / "keys"
    make_keys(keys, servers=[["s1", "s2"]], drones=["heron"], operators=["operator"])
    with daemon(folder, config(keys)) as at:
        with channel(at.address, shown(keys, "heron")) as heron:
            for path, body in _REQUESTS:
                with contextlib.suppress(grpc.RpcError, ValueError, UnicodeError):
                    heron.unary_unary(path)(msgspec.msgpack.encode(body), timeout=5.0)
        told = upwash("status", at.address, "--server", "s1", "--keys", keys)
        assert told.returncode == 0, told.stderr
    return (folder / "stderr").read_bytes().decode(errors="replace"), told.stdout


def unprintable(text: str) -> int:
    """How many characters of it are no text, ends of lines aside."""
    return sum(not each.isprintable() for each in text.replace("\n", ""))


def main() -> int:
    """Prints how many there are; returns 0 if there are none."""
    with tempfile.TemporaryDirectory() as folder:
        logged, told = map(unprintable, attacked(Path(folder)))
    print(f"unprintable characters: {logged} in the daemon's log, {told} on the operator's terminal")
    return 1 if logged or told else 0


if __name__ == "__main__":
    sys.exit(main())
