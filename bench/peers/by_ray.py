"""Ray: a head node at the server, `ray://` and `get(timeout=2)` at the drone."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable

import ray

TIMEOUT_S = 2.0
_PROBE = "import ray, sys; ray.init(f'ray://{sys.argv[1]}')"  # the port opens before Ray is ready
_PAUSE_S = 0.5


def serve(address: str, compute: object) -> None:
    """Serves until the process is ended."""
    host, _, port = address.rpartition(":")
    subprocess.Popen(
        (
            *(sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block"),
            *(f"--node-ip-address={host}", f"--ray-client-server-port={port}"),
            *("--include-dashboard=false", "--disable-usage-stats", "--num-cpus=2"),
            "--object-store-memory=200000000",
        ),
        stdout=subprocess.DEVNULL,
    )
    while subprocess.run((sys.executable, "-c", _PROBE, address), check=False).returncode != 0:
        time.sleep(_PAUSE_S)
    print("ready", flush=True)
    threading.Event().wait()


class Client:
    """Runs the computation as a remote task, and computes here where its result does not come."""

    def __init__(
        self, address: str, *, compute: Callable[[bytes], str], local: Callable[[bytes], str]
    ) -> None:
        ray.init(f"ray://{address}")
        self._look = ray.remote(lambda photo: compute(photo))  # noqa: PLW0108 - it takes functions alone
        self._local = local

    def call(self, photo: bytes) -> str:
        """Where it was computed."""
        try:
            return str(ray.get(self._look.remote(photo), timeout=TIMEOUT_S))
        except (ray.exceptions.RayError, ConnectionError):
            return self._local(photo)
