"""What a person sees of an edge daemon."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.core.visitors import RefusalStatus, ServerStatus
from upwash.protocol import CertificateStatus, StatusReply

_SOON_DAYS = 30
_STATE_STYLES = {"running": "green", "starting": "yellow", "stopping": "yellow"}


def print_status(status: StatusReply, console: Console) -> None:
    """Prints the servers with their leases and instances, the last refusals, and the certificates' ends."""
    console.print(f"up for {_duration(status.up_s)}", soft_wrap=True)
    if status.closing:
        console.print(Text(status.closing, style="bold red"), soft_wrap=True)
    for server in status.servers:
        _print_server(server, console)
    _print_refusals(status.refusals, console)
    _print_certificates(status.certificates, console)


def _print_server(server: ServerStatus, console: Console) -> None:
    console.print(f"\n{server.name}: {len(server.leases)} of {server.slots} slots in use", soft_wrap=True)
    for lease in server.leases:
        certificate = f", certificate {lease.certificate[:16]}" if lease.certificate else ""
        held = f", held for {lease.held_by}" if lease.held_by else ""
        line = f"  {lease.drone}: lease ends in {_duration(lease.ends_in_s)}{certificate}{held}"
        console.print(Text(line), soft_wrap=True)
    table = Table(box=None, padding=(0, 2))
    for column in ("instance", "state", "at", "unused for"):
        table.add_column(column)
    for instance in server.instances:
        unused = _duration(instance.unused_s) if instance.state == "running" else ""
        state = Text(instance.state, style=_STATE_STYLES.get(instance.state, "dim"))
        table.add_row(Text(instance.service), state, Text(instance.endpoint), unused)
    console.print(table)


def _print_refusals(refusals: Sequence[RefusalStatus], console: Console) -> None:
    if not refusals:
        return
    table = Table(box=None, padding=(0, 2), title="refused", title_justify="left")
    for column in ("last", "times", "server", "who", "why"):
        table.add_column(column)
    for each in refusals:
        ago = f"{_duration(each.ago_s)} ago"
        table.add_row(ago, str(each.times), *map(Text, (each.server, each.visitor, each.why)))
    console.print()
    console.print(table)


def _print_certificates(certificates: Sequence[CertificateStatus], console: Console) -> None:
    if certificates:
        console.print()
    for each in certificates:
        days = (each.expires - datetime.now(UTC)).days
        line = f"certificate of {each.holder}: valid until {each.expires:%Y-%m-%d}, {days} days"
        console.print(Text(line, style="bold red" if days < _SOON_DAYS else ""), soft_wrap=True)


def _duration(seconds: float) -> str:
    """Two units at most: 12 s, 3 min 4 s, 2 h 5 min, 6 d 7 h."""
    whole = round(seconds)
    for unit_s, unit, part_s, part in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole >= unit_s:
            return f"{whole // unit_s} {unit} {whole % unit_s // part_s} {part}"
    return f"{whole} s"
