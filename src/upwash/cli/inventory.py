"""What an operator sees of many servers: a line for each, and what is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime

from msgspec import Struct
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.config.inventory import ListedServer
from upwash.core.admission.clients import ServerStatus
from upwash.core.admission.slots import MOST_DRONES
from upwash.errors import LinkError
from upwash.launch.in_force import CONFIGURATION, KEYS, REVOCATIONS
from upwash.rpc.protocol import DaemonStatus, StatusReply
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import duration

SOON_DAYS = 30  # until a certificate ends
DIGITS = 12  # of a hash
_COLUMNS = (
    "server",
    "version",
    "slots",
    "queue",
    CONFIGURATION,
    REVOCATIONS,
    "last reload",
    "certificate",
    "wrong",
)


class ServerView(Struct, frozen=True):
    """A server. `reply` is None if its daemon did not answer; `differs` has the parts that most have otherwise."""

    server: str
    address: str
    reply: StatusReply | None
    differs: tuple[str, ...]
    wrong: tuple[str, ...]


def views(
    servers: Sequence[ListedServer], replies: Sequence[StatusReply | LinkError], now: datetime
) -> list[ServerView]:
    """Each server with its daemon's reply, or with the reason why there is none; `now` is the time here."""
    asked = list(zip(servers, replies, strict=True))
    daemons = ((server.address, reply.daemon) for server, reply in asked if isinstance(reply, StatusReply))
    differ = differing({address: daemon for address, daemon in daemons if daemon is not None})
    return [_view(server, reply, tuple(differ.get(server.address, ())), now) for server, reply in asked]


def _view(
    server: ListedServer, reply: StatusReply | LinkError, differs: tuple[str, ...], now: datetime
) -> ServerView:
    if isinstance(reply, LinkError):
        return ServerView(server.name, server.address, None, differs, (str(reply),))
    unlike = (f"{part}: not as on the other servers" for part in differs)
    wrong = (*_wrong(server.name, reply, now), *unlike)
    return ServerView(server.name, server.address, reply, differs, wrong)


def differing(daemons: Mapping[str, DaemonStatus]) -> dict[str, list[str]]:
    """The parts of each daemon whose digest is another than that of more than half of the daemons, by address.

    Without a digest of more than half, all revocations differ, because they should be the same everywhere; other
    parts may be each daemon's own. Keys are always a daemon's own.
    """
    differ: dict[str, list[str]] = {}
    parts = dict.fromkeys(part for daemon in daemons.values() for part in daemon.parts if part != KEYS)
    for part in parts:
        digests = {at: daemon.parts[part].digest for at, daemon in daemons.items() if part in daemon.parts}
        ((most, count), *less) = Counter(digests.values()).most_common()
        is_majority = 2 * count > len(digests)
        if less and (is_majority or part == REVOCATIONS):
            for at, digest in digests.items():
                if digest != most or not is_majority:
                    differ.setdefault(at, []).append(part)
    return differ


def _wrong(name: str, reply: StatusReply, now: datetime) -> Iterator[str]:
    """What is wrong with a server that answered, except for differences from other servers."""
    if reply.closing:
        yield reply.closing
    for part, known in reply.daemon.parts.items() if reply.daemon is not None else ():
        if known.refused:
            yield f"{part}: the old stays: {known.refused}"
    server = _server(name, reply)
    if server is None:
        yield f"the daemon there acts as {', '.join(each.name for each in reply.servers)}"
    for instance in server.instances if server is not None else ():
        if instance.paused_s:
            yield f"{instance.service} keeps failing: {instance.last_failure}"
        if instance.not_renewed:
            yield f"{instance.service}: the new version did not start: {instance.not_renewed}"
    for certificate in reply.certificates:
        if (days := (certificate.expires - now).days) < SOON_DAYS:
            yield f"the certificate of {certificate.holder} ends in {days} d"


def is_limited(server: ServerStatus) -> bool:
    """Whether the number of slots is a limit; a measured one may be as large as the crowd that is remembered."""
    return server.slots_why in ("", "configured") or server.slots < MOST_DRONES


def _server(name: str, reply: StatusReply) -> ServerStatus | None:
    return next((server for server in reply.servers if server.name == name), None)


def print_views(found: Sequence[ServerView], console: Console) -> None:
    """Print a line for each server, and how many are well."""
    table = Table(*_COLUMNS, box=None, padding=(0, 2))
    for view in found:
        wrong = Text("; ".join(view.wrong), style="bold red")
        table.add_row(Text(view.server), *_cells(view), wrong)
    show_table(table, console)
    say(f"well: {sum(not view.wrong for view in found)} of {len(found)}", console)


def _cells(view: ServerView) -> Iterator[Text | str]:
    """The columns between the name and what is wrong; empty where nothing is known."""
    reply = view.reply
    server = None if reply is None else _server(view.server, reply)
    daemon = None if reply is None else reply.daemon
    yield "" if daemon is None else Text(daemon.version)
    used = 0 if server is None else len(server.leases)
    yield (
        ""
        if server is None
        else f"{used} of {server.slots}"
        if is_limited(server)
        else f"{used}, not limited"
    )
    yield "" if server is None else str(sum(each.waits_s is not None for each in server.accounts))
    for part in (CONFIGURATION, REVOCATIONS):
        known = None if daemon is None else daemon.parts.get(part)
        mark = "*" if part in view.differs else ""
        yield "" if known is None else Text(known.digest[:DIGITS] + mark, style="bold red" if mark else "")
    yield "" if daemon is None else _reload(daemon)
    ends = [certificate.expires for certificate in reply.certificates] if reply is not None else []
    yield f"until {min(ends):%Y-%m-%d}" if ends else ""


def _reload(daemon: DaemonStatus) -> str:
    if daemon.reload is None:
        return "none"
    ago = f"{duration((daemon.time - daemon.reload.asked).total_seconds())} ago"
    if daemon.reload.ended is None:
        return f"{ago}, under way"
    return f"{ago}, refused" if any(known.refused for known in daemon.parts.values()) else ago
