"""The radio: two network namespaces joined by a cable of 54 Mbit/s each way."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator

from upwash.emulation.namespaces import LinkEnd, command, inside, join_by_cable, make_namespace

DRONE = LinkEnd("drone", "radio", "10.54.0.1")
SERVER = LinkEnd("server", "radio", "10.54.0.2")
# The burst is small: its bytes pass faster than the link's rate. The queue takes a whole request.
_SHAPE = "tbf rate 54mbit burst 3200 latency 100ms"
_DROP = """\
table inet dark {
    chain in {
        type filter hook input priority 0
        iifname "radio" drop
    }
}
"""


def make_link() -> None:
    """Makes both ends, in a network namespace where nothing else has these names."""
    for end in (DRONE, SERVER):
        make_namespace(end.namespace)
    join_by_cable(DRONE, SERVER)
    for end in (DRONE, SERVER):
        command("tc", "-n", end.namespace, "qdisc", "add", "dev", end.device, "root", *_SHAPE.split())


@contextlib.contextmanager
def dark() -> Iterator[None]:
    """Lose every frame both ways, as a radio out of reach; no program and no kernel gets an error."""
    for end in (DRONE, SERVER):
        subprocess.run([*inside(end.namespace), "nft", "-f", "-"], input=_DROP, text=True, check=True)
    try:
        yield
    finally:
        for end in (DRONE, SERVER):
            command(*inside(end.namespace), "nft", "delete", "table", "inet", "dark")
