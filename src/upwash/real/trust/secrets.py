"""Files of secrets, which no other person may read, and files of certificates."""

from __future__ import annotations

import codecs
import grp
import os
import pwd
import shlex
import ssl
import stat
from pathlib import Path

from upwash.errors import CredentialsError
from upwash.support.input_files import text_of

_MOST_BYTES = 2**20
_MARKS = (codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_RAW_KEY_BYTES = 32  # a signing key, which may begin with any bytes
_ROOT = 0


def read_secret(file: Path) -> bytes:
    """The contents of a secret file; raises CredentialsError if other users can read or change it."""
    content, status = _read(file)
    problem = exposure(
        stat.S_IMODE(status.st_mode),
        owner=status.st_uid,
        in_private_group=_is_private(status.st_gid, owner=status.st_uid),
    )
    if problem:
        raise CredentialsError(f"{file}: {problem}: {_remedy(file, owner=status.st_uid)}")
    return content


def read_public(file: Path) -> bytes:
    """The contents of a file that all users may read; raises CredentialsError."""
    return _read(file)[0]


def exposure(mode: int, *, owner: int, in_private_group: bool = False) -> str:
    """Which other users may read or change a file of that mode and owner, in words; "" if none may.

    The group may read a file that root owns, so that a service with a user of its own can read it, and a file in a
    group without other people.
    """
    too_much = mode & 0o077 & ~(0o040 if owner == _ROOT or in_private_group else 0)
    if not too_much:
        return ""
    who = "others" if too_much & 0o007 else "its group"
    return f"{who} can {'read' if too_much & 0o044 else 'change'} it (mode {mode:04o})"


def _is_private(group: int, *, owner: int) -> bool:
    """Whether the group is one of this program's, and has no other people than its user, the owner and root."""
    if group not in {os.getegid(), *os.getgroups()}:
        return False
    try:
        members = set(grp.getgrgid(group).gr_mem)
    except KeyError:  # as in a container, whose files of users are those of the image
        members = set()
    users = pwd.getpwall()
    members |= {user.pw_name for user in users if user.pw_gid == group}
    return members <= {user.pw_name for user in users if user.pw_uid in (_ROOT, owner, os.geteuid())}


def _remedy(file: Path, *, owner: int) -> str:
    """The command after which this program reads the file, and no other user does."""
    user, words = os.geteuid(), [["chmod", "600", str(file)]]
    if user not in (_ROOT, owner):
        words.insert(0, ["chown", str(user), str(file)])
    return f"`{' && '.join(map(shlex.join, words))}`" + (", as root" if len(words) > 1 else "")


def load_secret(context: ssl.SSLContext, pem: bytes) -> None:
    """Loads a certificate and its key from a PEM text into the context."""
    secret = os.memfd_create("secret")  # the ssl module reads files only
    try:
        os.write(secret, pem)
        context.load_cert_chain(f"/proc/self/fd/{secret}")
    finally:
        os.close(secret)


def _read(file: Path) -> tuple[bytes, os.stat_result]:
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe would be waited for
        with os.fdopen(descriptor, "rb") as opened:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise CredentialsError(f"{file}: cannot be read (not a file): check the path")
            content = opened.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        raise CredentialsError(f"{file}: no such file: check the path, or make the keys first") from None
    except OSError as error:
        raise CredentialsError(
            f"{file}: cannot be read ({error.strerror}): run as the user that owns it"
        ) from None
    if len(content) > _MOST_BYTES:
        raise CredentialsError(f"{file}: more than 1 MiB, which no key or certificate has: check the path")
    return _without_mark(content), status


def _without_mark(content: bytes) -> bytes:
    """The content, without a byte order mark if it is a text."""
    if not content.startswith(_MARKS) or len(content) == _RAW_KEY_BYTES:
        return content
    try:
        return text_of(content).encode()
    except ValueError:
        return content
