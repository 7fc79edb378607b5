"""A peer's server: `python -m bench.peers.server PEER HOST:PORT FOLDER`. It says when it is ready."""

from __future__ import annotations

import importlib
import sys
from functools import partial

from bench.peers.computation import on_server

if __name__ == "__main__":
    peer, address, folder = sys.argv[1:]
    importlib.import_module(f"bench.peers.by_{peer}").serve(address, partial(on_server, folder))
