"""The key for signed messages in its file, and beside it the latest time that was used with it."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from upwash.errors import CredentialsError, UsageError
from upwash.mavlink.signing import Signing, key_of, key_of_passphrase
from upwash.real.trust.secrets import read_secret

_PASSPHRASE_BYTES = 24


def read_signing(file: Path) -> Signing:
    """The signing with the file's key, at later times than any earlier program used; raises CredentialsError.

    The latest time is kept in a file beside it, with the suffix `.time`, as a computer may start with a clock that is
    behind.
    """
    key = read_key(file)
    kept_in = file.with_name(f"{file.name}.time")
    try:
        kept = _kept(kept_in)
        _keep(kept_in, kept)
    except (OSError, ValueError) as error:
        raise CredentialsError(
            f"{kept_in} cannot be kept ({getattr(error, 'strerror', None) or error}): it holds the time of the last "
            f"signed message; let this user write to {kept_in.parent}, or remove the file if it is broken"
        ) from error

    def keep(latest: int) -> None:
        with contextlib.suppress(OSError):  # a full disk in flight: this computer's clock has to do then
            _keep(kept_in, latest)

    return Signing(key, kept=kept, keep=keep)


def read_key(file: Path) -> bytes:
    """The key in a file; raises CredentialsError."""
    try:
        return key_of(read_secret(file))
    except ValueError as error:
        raise CredentialsError(f"{file} {error}; make one with `upwash keys --signing FILE`") from None


def make_signing_key(file: Path) -> str:
    """Writes a new key; returns the passphrase that gives a ground station the same key."""
    passphrase = secrets.token_urlsafe(_PASSPHRASE_BYTES)
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise UsageError(f"{file} is there already: give another file, or remove it") from None
    with os.fdopen(descriptor, "w") as opened:
        opened.write(f"{key_of_passphrase(passphrase).hex()}\n")
    return passphrase


def _kept(file: Path) -> int:
    """The time in the file, 0 without a file; ValueError for any other content."""
    try:
        text = file.read_text()
    except FileNotFoundError:
        return 0
    if not text.strip().isdecimal() or int(text) >= 2**48:
        raise ValueError("it holds no time")
    return int(text)


def _keep(file: Path, latest: int) -> None:
    whole = file.with_name(f"{file.name}.new")
    whole.write_text(f"{latest}\n")
    whole.replace(file)
