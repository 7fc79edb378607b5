"""A peer's client: `python -m bench.peers.drone PEER HOST:PORT FOLDER LOCAL_S CALLS`."""

from __future__ import annotations

import importlib
import os
import sys
from functools import partial

from bench.peers.calls import PHOTO_BYTES, make_calls
from bench.peers.computation import on_drone, on_server

if __name__ == "__main__":
    peer, address, folder, local_s, calls = sys.argv[1:]
    client = importlib.import_module(f"bench.peers.by_{peer}").Client(
        address, compute=partial(on_server, folder), local=partial(on_drone, folder, float(local_s))
    )
    make_calls(client.call, os.urandom(PHOTO_BYTES), folder=folder, calls=int(calls))
    sys.stdout.flush()
    os._exit(0)  # what a peer still waits for is no part of the mission
