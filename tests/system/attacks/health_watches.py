"""Opens and cancels health watches for ever: `python -m tests.system.attacks.health_watches PORT KEYS NAME`."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import grpc

from upwash.real.trust.authority import keys_in

AT_ONCE = 1000
WATCH = "/grpc.health.v1.Health/Watch"


def main(port: str, keys: str, drone: str) -> None:
    """Says "attacking" once the first thousand are open."""
    files = keys_in(Path(keys), drone)
    shown = grpc.ssl_channel_credentials(
        files.authority.read_bytes(), files.key.read_bytes(), files.certificate.read_bytes()
    )
    options = [("grpc.ssl_target_name_override", "s1"), ("grpc.use_local_subchannel_pool", 1)]
    for number in itertools.count():
        with grpc.secure_channel(f"127.0.0.1:{port}", shown, options) as channel:
            watch = channel.unary_stream(WATCH)
            streams = [watch(b"", timeout=10.0) for _ in range(AT_ONCE)]
            if number == 0:
                print("attacking", flush=True)
            for stream in streams:
                stream.cancel()


if __name__ == "__main__":
    main(*sys.argv[1:])
