"""An operator's list of servers: what each is called, and where its daemon listens."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from upwash.config import values
from upwash.config.problems import address_problems, name_problems
from upwash.config.reading import convert, read_document, refuse_first


class ListedServer(Struct, frozen=True, kw_only=True):
    """A server of the list."""

    name: values.Name
    """The server's name, which the daemon's certificate has."""
    address: values.Text
    """The daemon's address, `host:port` or `unix:path`."""


class _Inventory(Struct, frozen=True, kw_only=True, rename={"servers": "server"}):
    """The list; it may have more keys, because a drone's configuration is a list too."""

    servers: Annotated[
        tuple[ListedServer, ...],
        Meta(
            min_length=1,
            max_length=1000,
            description="tables that each begin with [[server]], from 1 to 1,000",
        ),
    ]


def read_inventory(file: Path) -> tuple[ListedServer, ...]:
    """The servers of the file; raises ConfigError."""
    document = read_document(file)
    servers = convert(document, _Inventory, file=file, as_written=document).servers
    refuse_first(file, name_problems("server", [server.name for server in servers]))
    for index, server in enumerate(servers):
        refuse_first(file, address_problems(f"server[{index}].address", server.address))
    return servers
