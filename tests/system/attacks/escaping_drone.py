"""A drone with a certificate that puts control characters wherever a daemon takes text.

python -m tests.system.attacks.escaping_drone        says how many reach the daemon's log and an operator's terminal
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import grpc
import msgspec
from tests.system.daemons import Daemon, config, daemon

from upwash.real.trust.authority import keys_in, make_keys
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


def speak(at: Daemon, keys: Path, drone: str = "heron") -> None:
    """Sends all of it, whatever comes back."""
    files = keys_in(keys, drone)
    shown = grpc.ssl_channel_credentials(
        *(file.read_bytes() for file in (files.authority, files.key, files.certificate))
    )
    options = [("grpc.ssl_target_name_override", "s1"), ("grpc.enable_http_proxy", 0)]
    with grpc.secure_channel(at.address, shown, options) as channel:
        for path, body in _REQUESTS:
            with contextlib.suppress(grpc.RpcError, ValueError, UnicodeError):
                channel.unary_unary(path)(msgspec.msgpack.encode(body), timeout=5.0)


def unprintable(text: str) -> int:
    """How many characters of it are no text, ends of lines aside."""
    return sum(not each.isprintable() for each in text.replace("\n", ""))


def told(at: Daemon, keys: Path) -> str:
    """What `upwash status` prints of the daemon."""
    command = ["status", at.address, "--server", "s1", "--keys", str(keys)]
    asked = subprocess.run(
        [sys.executable, "-m", "upwash", *command], capture_output=True, timeout=30.0, check=True
    )
    return asked.stdout.decode()


def main() -> int:
    """Prints how many there are; returns 0 if there are none."""
    with tempfile.TemporaryDirectory() as name:
        folder, keys = Path(name), Path(name, "keys")
        make_keys(keys, servers=[["s1", "s2"]], drones=["heron"], operators=["operator"])
        with daemon(folder, config(keys)) as at:
            speak(at, keys)
            shown = unprintable(told(at, keys))
        logged = unprintable((folder / "stderr").read_bytes().decode(errors="replace"))
    print(f"unprintable characters: {logged} in the daemon's log, {shown} on the operator's terminal")
    return 1 if logged or shown else 0


if __name__ == "__main__":
    sys.exit(main())
