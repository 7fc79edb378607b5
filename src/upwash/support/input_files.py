"""Files that a user names: read with a bound on their size, and TOML with a bound on its nesting.

A device, an idle pipe or an endless file is refused within a second.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import os
import re
import select
import stat
import tomllib
from pathlib import Path

from upwash.errors import ConfigError

_CHUNK_BYTES = 2**16
_PIPE_PATIENCE_MS = 500
_MOST_PARTS = 32  # of a dotted key
_PART = r"""(?:(?<![\w-])[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:{_PART}[ \t]*+\.[ \t]*+){{{_MOST_PARTS}}}", re.ASCII)


def read_file(file: Path, *, most_bytes: int) -> bytes:
    """The content of a file or of a pipe; raises OSError, or ValueError if it is larger or something else."""
    # Not blocking: opening a pipe would wait for its writer.
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
        if not (stat.S_ISREG(mode) or stat.S_ISFIFO(mode)):
            raise ValueError("it is a device or a socket, not a file")
        content = bytearray()
        while chunk := _next_chunk(descriptor, is_pipe=stat.S_ISFIFO(mode)):
            content += chunk
            if len(content) > most_bytes:
                raise ValueError(f"it is larger than {most_bytes / 1e6:g} MB")
    finally:
        os.close(descriptor)
    return bytes(content)


def read_named_text(file: Path, *, most_bytes: int) -> str:
    """The text of a file or of a pipe; raises ConfigError, which says what to do."""
    return named_text(read_named_file(file, most_bytes=most_bytes), file)


def named_text(content: bytes, file: Path) -> str:
    """The text in the content of the file; raises ConfigError, which says what to do."""
    try:
        return text_of(content)
    except UnicodeDecodeError as error:
        problem = f"not UTF-8 text (byte {error.start}): save it as UTF-8"
        raise ConfigError(str(file), "", problem) from None


def read_named_file(file: Path, *, most_bytes: int) -> bytes:
    """The content of a file or of a pipe; raises ConfigError, which says what to do."""
    try:
        return read_file(file, most_bytes=most_bytes)
    except FileNotFoundError:
        raise ConfigError(str(file), "", "no such file: check the path") from None
    except (OSError, ValueError) as error:
        problem = f"cannot be read ({why_unreadable(error)}): name a readable file"
        raise ConfigError(str(file), "", problem) from None


def with_data(file: Path) -> list[Path]:
    """The file, and the file beside it that has the numbers of an ONNX model, as PyTorch's tools write it."""
    if file.suffix != ".onnx":
        return [file]
    beside = (file.with_name(file.name + ending) for ending in (".data", "_data"))
    return [file, *(data for data in beside if data.is_file())]


def why_unreadable(error: OSError | ValueError) -> str:
    """The message of a failed `read_file`, without the name of the file."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def text_of(content: bytes) -> str:
    """The text in a file's content, as editors and shells of Windows write it too.

    The encoding is UTF-8, or UTF-16 with a byte order mark. Raises UnicodeDecodeError, a ValueError.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        with contextlib.suppress(UnicodeDecodeError):
            return content.decode("utf-16")
    return content.decode("utf-8-sig")


def read_toml(text: str) -> dict[str, object]:
    """The tables of the TOML; raises ValueError if it is invalid or nested too deeply."""
    # Before parsing, whose time and memory grow with the square of the parts.
    if found := _LONG_KEY.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise ValueError(f"line {line}: a key has more than {_MOST_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("arrays or tables are nested too deeply") from None


def _next_chunk(descriptor: int, *, is_pipe: bool) -> bytes:
    if is_pipe:
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        if not poll.poll(_PIPE_PATIENCE_MS):
            raise ValueError(f"nothing came through the pipe within {_PIPE_PATIENCE_MS / 1000:g} s")
    return os.read(descriptor, _CHUNK_BYTES)
