"""The standard streams of a program, which may be closed, full, or a pipe without a reader."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

from upwash.errors import UpwashError


class Forgiving:
    """A text stream that never raises; what `stream` does not take is lost, for the reason in `trouble`."""

    def __init__(self, stream: TextIO) -> None:
        self.trouble: OSError | None = None
        self._stream = stream

    def write(self, text: str) -> int:
        """Write the text, if possible."""
        with self._noting_trouble():
            self._stream.write(text)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write one after the other."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the stream, if possible."""
        with self._noting_trouble():
            self._stream.flush()

    @contextlib.contextmanager
    def _noting_trouble(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.trouble = self.trouble or error

    def __getattr__(self, name: str) -> Any:
        """All other attributes are those of the stream."""
        return getattr(self._stream, name)


@contextlib.contextmanager
def forgiving_streams() -> Iterator[Forgiving]:
    """Let no print within the block raise; yields standard output, with the first failure in `trouble`."""
    output, errors = _forgiving(sys.stdout), _forgiving(sys.stderr)
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            yield output
        finally:
            output.flush()


def _forgiving(stream: TextIO | Forgiving) -> Forgiving:
    return stream if isinstance(stream, Forgiving) else Forgiving(stream)


def print_bytes(content: bytes | Iterable[bytes]) -> None:
    """Print bytes, which may come in pieces; raises UpwashError if standard output does not take all of them."""
    try:
        sys.stdout.buffer.writelines((content,) if isinstance(content, bytes) else content)
        sys.stdout.buffer.flush()
    except OSError as error:
        give_up_output()
        raise UpwashError(f"standard output cannot be written ({error.strerror})") from error


def open_closed_streams() -> None:
    """Point closed standard streams to /dev/null: else the next opened file would become one of them."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            _lead_nowhere(number)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def give_up_output() -> None:
    """Point standard output to /dev/null: else the interpreter tries again at its end to print the rest."""
    with contextlib.suppress(OSError, ValueError):
        _lead_nowhere(sys.stdout.fileno())


def _lead_nowhere(descriptor: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere != descriptor:
        os.dup2(nowhere, descriptor)
        os.close(nowhere)
