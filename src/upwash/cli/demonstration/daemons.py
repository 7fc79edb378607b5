"""The demonstration's edge daemons, each a process of its own."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from upwash.launch.processes import ready_program
from upwash.support.output_files import write_file

_RUNTIME = "[runtime]\nsandbox_as_root = true\n"  # whoever tries it out may be root


@contextlib.contextmanager
def ready_daemons(names: Sequence[str], folder: Path, *, runtime: str) -> Iterator[Mapping[str, str]]:
    """Runs a daemon for each of the servers until the end of the block; yields where each of them listens.

    Their keys are in the folder. `runtime` is what their configuration is to say besides, in TOML: a table [runtime].
    """
    addresses = dict(zip(names, _free_addresses(len(names)), strict=True))
    with contextlib.ExitStack() as processes:
        for name in names:
            file = folder / f"{name}.toml"
            write_file(file, _configuration(name, addresses, runtime or _RUNTIME).encode())
            processes.enter_context(ready_program(name, folder, "serve", "--config", str(file)))
        yield addresses


def _free_addresses(count: int) -> list[str]:
    """Addresses of this machine that nobody listens at now; peers have to know each other's before they start."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [f"127.0.0.1:{each.getsockname()[1]}" for each in sockets]


def _configuration(name: str, addresses: Mapping[str, str], runtime: str) -> str:
    peers = "".join(
        f'[[peer]]\nname = "{peer}"\naddress = "{address}"\n\n'
        for peer, address in addresses.items()
        if peer != name
    )
    return (
        f'listen = "{addresses[name]}"\n\n'
        f"[keys]\n"
        f'authority = "keys/authority.pem"\ncertificate = "keys/{name}.pem"\nkey = "keys/{name}.key"\n\n'
        f'[[service]]\nname = "detector"\n\n'
        f'[[server]]\nname = "{name}"\n\n{peers}{runtime}'
    )
