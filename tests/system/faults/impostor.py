"""Takes a daemon's place with its certificate: `python -m tests.system.faults.impostor MANNER ADDRESS KEYS SERVER`.

After the handshake it answers whatever it is asked with garbage, or with nothing.
"""

from __future__ import annotations

import asyncio
import os
import ssl
import sys
from pathlib import Path

from upwash.real.trust.authority import keys_in

_GARBAGE_BYTES = 10_000


async def main(manner: str, address: str, keys: Path, server: str) -> None:
    files = keys_in(keys, server)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=str(files.authority))
    context.load_cert_chain(files.certificate, files.key)
    context.set_alpn_protocols(["h2"])

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while await reader.read(65536):
                if manner == "garbage":
                    writer.write(os.urandom(_GARBAGE_BYTES))
                    await writer.drain()
        except (ConnectionError, ssl.SSLError):
            pass  # who called has had enough
        finally:
            writer.close()

    host, _, port = address.rpartition(":")
    listening = await asyncio.start_server(answer, host, int(port), ssl=context)
    print("ready", flush=True)
    await listening.serve_forever()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), sys.argv[4]))
