"""upwash status: asks an edge daemon how it is, or many."""

from __future__ import annotations

import argparse
import asyncio
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from upwash.cli.arguments import OneOf, announce, option, reads
from upwash.cli.inventory import DIGITS, SOON_DAYS, is_limited, print_views, views
from upwash.config.inventory import ListedServer, read_inventory
from upwash.core.admission.clients import (
    AccountStatus,
    DroneUsage,
    InstanceStatus,
    RefusalStatus,
    ServerStatus,
    TeamUsage,
)
from upwash.core.admission.limits import Limits
from upwash.errors import LinkError, UsageError
from upwash.launch.in_force import clock_state
from upwash.launch.status import ask_each, ask_status
from upwash.real.trust.credentials import at_second
from upwash.rpc.protocol import CertificateStatus, DaemonStatus, ReloadStatus, StatusReply
from upwash.support.sentences import say
from upwash.support.tables import show_table
from upwash.support.text import counted, duration

_MOST_SHOWN = 20
_WATCH_S = 5.0
_USAGE = ("slots in all", "calls", "computing", "last call")
_STATE_STYLES = {"running": "green", "starting": "yellow", "stopping": "yellow"}


ARGUMENTS = {
    "address ADDRESS": option("of the daemon: host:port, or unix:path", nargs="?"),
    "--inventory FILE": reads(
        "ask the servers of this TOML file at once, print a line for each, and end with code 1 if one is not well; "
        "it has a table [[server]] with name and address for each, as a drone's configuration"
    ),
    "--server NAME": option("a server that the daemon acts as", default=""),
    "--operator NAME": option(
        "the operator whose certificate is used (default: operator)", default="operator"
    ),
    "--keys DIR": reads(
        "where authority.pem, NAME.pem and NAME.key lie; without it none are used, on this machine only"
    ),
    "shown": OneOf(
        {
            "--json": "print the answer as JSON, for programs",
            "--watch": "ask again every 5 s, until Ctrl-C",
        }
    ),
}


def run(options: argparse.Namespace) -> bool:
    """Ask the daemon, or each of the list, and print the answers; true where no server of a list has a problem."""
    if (options.address is None) == (options.inventory is None):
        raise UsageError("name a daemon's address, or a list of servers by --inventory FILE: one of them")
    if options.inventory is not None and options.server:
        raise UsageError("--server is for an address: the list of --inventory names its servers")
    servers = read_inventory(options.inventory) if options.inventory else []
    console = Console(markup=False)
    while True:
        is_well = _ask_each(servers, options, console) if options.inventory else _ask(options, console)
        if not options.watch:
            return is_well
        time.sleep(_WATCH_S)


def _ask(options: argparse.Namespace, console: Console) -> bool:
    asked = ask_status(options.address, server=options.server, operator=options.operator, keys=options.keys)
    try:
        reply = asyncio.run(asked)
    except LinkError as error:
        if not options.watch:
            raise
        console.clear()
        say(Text(str(error), style="bold red"), console)
        return False
    if options.json:
        announce(msgspec.json.encode(reply).decode())
        return True
    if options.watch:
        console.clear()
    print_status(reply, console)
    return True


def _ask_each(servers: Sequence[ListedServer], options: argparse.Namespace, console: Console) -> bool:
    replies = asyncio.run(ask_each(servers, operator=options.operator, keys=options.keys))
    found = views(servers, replies, datetime.now(UTC))
    if options.json:
        announce(msgspec.json.encode(found).decode())
    else:
        if options.watch:
            console.clear()
        print_views(found, console)
    return not any(view.wrong for view in found)


def print_status(status: StatusReply, console: Console) -> None:
    """Print the servers with drones and instances, the limits, the last refusals, and the certificates' ends."""
    say(f"up for {duration(status.up_s)}", console)
    if status.daemon is not None:
        _print_daemon(status.daemon, console)
    if status.closing:
        say(Text(status.closing, style="bold red"), console)
    for server in status.servers:
        _print_server(server, console)
    _print_limits(status.limits, console)
    _print_refusals(status.refusals, console)
    for door in status.at_door:
        times = counted(door.times, "connection")
        reason = door.reason.replace("_", " ")
        say(
            Text(f"at the door {times} refused, {reason}: last {door.last}, {duration(door.ago_s)} ago"),
            console,
        )
    _print_certificates(status.certificates, console)


def _print_daemon(daemon: DaemonStatus, console: Console) -> None:
    """Print which program runs, what is in force since when, and what the last reload refused."""
    commit = f" (commit {daemon.commit[:DIGITS]})" if daemon.commit else ""
    say(
        Text(f"upwash {daemon.version}{commit}, code {daemon.code[:DIGITS]}, sandbox {daemon.sandbox}"),
        console,
    )
    say(f"its clock says {at_second(daemon.time)}, and {clock_state(daemon)}", console)
    table = _table("in force", "hash", "since", "")
    for part, status in daemon.parts.items():
        revoked = counted(daemon.revoked, "certificate") if part == "revocations" else ""
        table.add_row(Text(part), status.digest[:DIGITS], at_second(status.since), revoked)
    show_table(table, console)
    if daemon.reload is not None:
        _print_reload(daemon.reload, {part: known.refused for part, known in daemon.parts.items()}, console)


def _print_reload(reload: ReloadStatus, refused: Mapping[str, str], console: Console) -> None:
    asked = f"last reload: {at_second(reload.asked)}, as {reload.by} ordered"
    if reload.ended is None:
        say(Text(f"{asked}: it is under way", style="yellow"), console)
    elif any(refused.values()):
        say(Text(f"{asked}: refused in part", style="bold red"), console)
    else:
        say(Text(f"{asked}: all was read"), console)
    for part, why in refused.items():
        if why:
            say(Text(f"  {part}: the old stays: {why}", style="bold red"), console)


def _print_server(server: ServerStatus, console: Console) -> None:
    waiting = sum(account.waits_s is not None for account in server.accounts)
    queue = f", {waiting} {'drone waits' if waiting == 1 else 'drones wait'}" if waiting else ""
    used = len(server.leases)
    slots = f"{used} of {counted(server.slots, 'slot')} in use"
    if not is_limited(server):
        slots = f"{counted(used, 'slot')} in use, not limited"
    say(f"\n{server.name}: {slots}{queue}", console)
    if server.slots_why:  # of a daemon that knows turns
        say(Text(f"  {_slots_and_turns(server)}"), console)
    for line in (*_holders(server), *_waiting(server)):
        say(Text(f"  {line}"), console)
    if server.instances:
        show_table(_instances(server), console)
    _print_usage(server, console)
    for instance in server.instances:
        service = instance.service
        if instance.failures:
            say(Text(f"  {_failed(instance)}", style="yellow"), console)
        if instance.renewed:
            times = counted(instance.renewed, "time")
            say(Text(f"  {service}: another version took over {times}"), console)
        if instance.not_renewed:
            why = f"the former version serves on, as the new one did not start: {instance.not_renewed}"
            say(Text(f"  {service}: {why}", style="yellow"), console)


def _slots_and_turns(server: ServerStatus) -> str:
    slots = f"{counted(server.slots, 'slot')}, as {server.slots_why}"
    if server.turn_s is None:
        return f"{slots}; turns have no end"
    have = "has" if server.turns_ended == 1 else "have"
    ended = f", {server.turns_ended} {have} ended so far" if server.turns_ended else ""
    return f"{slots}; a turn lasts {duration(server.turn_s)}{ended}"


def _holders(server: ServerStatus) -> Iterator[str]:
    """A line for each drone that has a slot, by name."""
    accounts = {account.drone: account for account in server.accounts}
    for lease in server.leases:
        account = accounts.get(lease.drone)
        since = ""
        if account is not None and account.holds_s is not None:
            since = f"has a slot for {duration(account.holds_s)}, {_counts_as(account)}; "
        certificate = f", certificate {lease.certificate}" if lease.certificate else ""
        held = f", held as {lease.held_by} asked" if lease.held_by else ""
        yield f"{lease.drone}: {since}lease ends in {duration(lease.ends_in_s)}{certificate}{held}"


def _waiting(server: ServerStatus) -> Iterator[str]:
    """A line for each drone that waits for a slot, the next one first."""
    waiting = [(account, account.waits_s) for account in server.accounts if account.waits_s is not None]
    for account, waits_s in sorted(waiting, key=lambda entry: (entry[0].had_s, -entry[1], entry[0].drone)):
        yield f"{account.drone}: waits for {duration(waits_s)}, {_counts_as(account)}"


def _counts_as(account: AccountStatus) -> str:
    return f"counts as having had {duration(account.had_s)}"


def _print_usage(server: ServerStatus, console: Console) -> None:
    """Print what the latest drones used, and their teams, if a drone's name has a team in it."""
    latest = sorted(server.drones, key=lambda usage: (usage.holds_s is None, _ago_s(usage), usage.drone))
    if latest:
        table = _table("drone", "slot for", *_USAGE)
        for usage in latest[:_MOST_SHOWN]:
            holds = "" if usage.holds_s is None else duration(usage.holds_s)
            table.add_row(Text(usage.drone), holds, *_used(usage))
        show_table(table, console)
    if len(latest) > _MOST_SHOWN:
        say(Text(f"  and {len(latest) - _MOST_SHOWN} more: see --json"), console)
    if any(usage.team != usage.drone for usage in server.drones):
        table = _table("team", "slots", *_USAGE)
        teams = sorted(server.teams, key=lambda team: (-team.slots, _ago_s(team), team.team))
        for team in teams[:_MOST_SHOWN]:
            table.add_row(Text(team.team), str(team.slots), *_used(team))
        show_table(table, console)


def _used(usage: DroneUsage | TeamUsage) -> tuple[str, str, str, str]:
    ago = "" if usage.called_ago_s is None else f"{duration(usage.called_ago_s)} ago"
    return duration(usage.slot_s), str(usage.calls), f"{usage.computed_s:.1f} s", ago


def _ago_s(usage: DroneUsage | TeamUsage) -> float:
    return math.inf if usage.called_ago_s is None else usage.called_ago_s


def _instances(server: ServerStatus) -> Table:
    table = _table("instance", "state", "at", "unused for")
    for instance in server.instances:
        unused = duration(instance.unused_s) if instance.state == "running" else ""
        words = "starts on demand" if instance.state == "absent" else instance.state
        state = Text(words, style=_STATE_STYLES.get(instance.state, "dim"))
        table.add_row(Text(instance.service), state, Text(instance.endpoint), unused)
    return table


def _failed(instance: InstanceStatus) -> str:
    """How the last instances of a service failed, and what the daemon does about that."""
    times = counted(instance.failures, "instance")
    paused = f"; left alone for another {duration(instance.paused_s)}" if instance.paused_s else ""
    replaced = f"; {instance.replaced} replaced so far" if instance.replaced else ""
    return f"{instance.service}: {times} failed in a row, last: {instance.last_failure}{paused}{replaced}"


def _print_limits(limits: Mapping[str, Limits], console: Console) -> None:
    if limits:
        say("\nlimits of each instance", console)
    for service, most in sorted(limits.items()):
        say(Text(f"  {service}: {', '.join(_held(most)) or 'none'}"), console)


def _held(most: Limits) -> Iterator[str]:
    if most.memory_bytes is not None:
        yield f"{_size(most.memory_bytes)} of memory"
    if most.cpus is not None:
        yield counted(most.cpus, "processor")
    if most.processes is not None:
        yield counted(most.processes, "process")
    if most.disk_bytes is not None:
        yield f"{_size(most.disk_bytes)} of files"


def _print_refusals(refusals: Sequence[RefusalStatus], console: Console) -> None:
    if refusals:
        table = _table("last", "times", "server", "who", "why", title="refused")
        for refusal in refusals:
            who = map(Text, (refusal.server, refusal.client, refusal.why))
            table.add_row(f"{duration(refusal.ago_s)} ago", str(refusal.times), *who)
        console.print()
        show_table(table, console)


def _print_certificates(certificates: Sequence[CertificateStatus], console: Console) -> None:
    if certificates:
        console.print()
    for certificate in certificates:
        days = (certificate.expires - datetime.now(UTC)).days
        until = f"{certificate.expires:%Y-%m-%d}, {counted(days, 'day')}"
        line = f"certificate of {certificate.holder}: valid until {until}"
        say(Text(line, style="bold red" if days < SOON_DAYS else ""), console)


def _table(*columns: str, title: str | None = None) -> Table:
    return Table(*columns, box=None, padding=(0, 2), title=title, title_justify="left")


def _size(size_bytes: int) -> str:
    """In the larger of MiB and GiB that makes it at least 1, to three digits."""
    size, unit = (size_bytes / 2**30, "GiB") if size_bytes >= 2**30 else (size_bytes / 2**20, "MiB")
    return f"{size:.3g} {unit}" if size < 1000 else f"{size:.0f} {unit}"
