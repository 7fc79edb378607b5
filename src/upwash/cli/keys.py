"""upwash keys: makes an authority and certificates, revokes them, and shows what there is."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from upwash.cli.arguments import announce, fills, option, repeated, writes
from upwash.errors import UsageError
from upwash.real.mavlink.signing import make_signing_key
from upwash.real.trust.authority import drop_former_authorities, made_in, make_keys, renew_authority, revoke
from upwash.support.text import counted

_MOST_DAYS = 3652

_REVOKED = (
    "no daemon knows of it yet: copy revoked.txt to each, beside its authority.pem or where its keys.revoked says, "
    "and have it read that: systemctl reload upwash, or SIGHUP"
)
_NEW_AUTHORITY = (
    "copy authority.pem to every drone and server, and restart the daemons, before certificates of the new authority "
    "are in use; destroy the former's key once nothing more will be signed with it"
)
_DROPPED = "copy authority.pem to every drone and server, and restart the daemons: as yet they believe the former too"


def days(text: str) -> timedelta:
    """A time in whole days, from 1 to 3652."""
    if not text.isascii() or not text.isdecimal() or not 1 <= int(text[:5]) <= _MOST_DAYS:
        raise argparse.ArgumentTypeError(f"expected a number of days from 1 to {_MOST_DAYS}, found {text!r}")
    return timedelta(days=int(text))


ARGUMENTS = {
    "folder": fills("where they go; an authority that is there is used again", nargs="?"),
    "--server NAME[,NAME]": repeated(
        "a certificate for a daemon that acts as the server, or as each of several"
    ),
    "--drone NAME": repeated("a certificate for a drone"),
    "--operator NAME": repeated("a certificate for a person who may ask a daemon for its status"),
    "--revoke NAME": repeated(
        "revoke the certificate with that name or SHA-256 fingerprint: daemons refuse it"
    ),
    "--days DAYS": option(
        "for how long new certificates are valid (default: 730; at most until the authority's own ends)",
        type=days,
    ),
    "--signing FILE": writes("make a key for MAVLink messages, and print the passphrase for the autopilot"),
    "--new-authority": "make another authority, which signs from now on; what the former signed is believed "
    "beside it",
    "--drop-former-authorities": "from now on nothing is believed but what the present authority signed",
}


def run(options: argparse.Namespace) -> None:
    """Make, revoke or show, and print which files were written and what is left to do with them."""
    folder = options.folder
    wanted = options.server or options.drone or options.operator
    changes = options.revoke or options.new_authority or options.drop_former_authorities
    if options.signing is not None:
        passphrase = make_signing_key(options.signing)
        announce(str(options.signing))
        announce(f"passphrase for the ground station, shown once: {passphrase}")
        if not wanted and not changes:
            return
    if folder is None:
        raise UsageError("where certificates go, or lie, is missing: name a folder")
    if not wanted and not changes:
        _show(folder)
    if options.revoke:
        _announce([revoke(folder, options.revoke)], _REVOKED)
    if options.new_authority:
        _announce(renew_authority(folder), _NEW_AUTHORITY)
    if wanted:
        servers = [names.split(",") for names in options.server]
        _announce(
            make_keys(
                folder, servers=servers, drones=options.drone, operators=options.operator, lasts=options.days
            )
        )
    if options.drop_former_authorities:
        _announce([drop_former_authorities(folder)], _DROPPED)


def _show(folder: Path) -> None:
    made = made_in(folder)
    if not made:
        raise UsageError(
            f"{folder}: no certificates here: name at least one --server, --drone or --operator to make"
        )
    now = datetime.now(UTC)
    for key in made:
        left = "revoked" if key.is_revoked else counted((key.ends - now).days, "day")
        announce(f"{key.holder}  {key.role}  until {key.ends:%Y-%m-%d}  {left}  {key.fingerprint}")


def _announce(files: Sequence[Path], left_to_do: str = "") -> None:
    for file in files:
        announce(str(file))
    if left_to_do:
        print(left_to_do, file=sys.stderr)
