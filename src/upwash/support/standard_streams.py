"""The standard streams of a program, which may be closed, full, or a pipe that nobody reads any more."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

from upwash.errors import UpwashError


class Forgiving:
    """A text stream that takes everything; what the one below does not take is lost, for the reason in `trouble`."""

    def __init__(self, stream: TextIO) -> None:
        self.trouble: OSError | None = None
        self._stream = stream

    def write(self, text: str) -> int:
        """Writes it, if it can be written."""
        with self._noting_trouble():
            self._stream.write(text)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Writes one after the other."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Passes on what was written, if that can be."""
        with self._noting_trouble():
            self._stream.flush()

    @contextlib.contextmanager
    def _noting_trouble(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.trouble = self.trouble or error

    def __getattr__(self, name: str) -> Any:
        """Whatever else streams have is the one's below."""
        return getattr(self._stream, name)


@contextlib.contextmanager
def forgiving_streams() -> Iterator[Forgiving]:
    """Lets nothing that is printed within raise; yields standard output, which knows what went wrong with it."""
    output, errors = _forgiving(sys.stdout), _forgiving(sys.stderr)
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            yield output
        finally:
            output.flush()


def _forgiving(stream: TextIO | Forgiving) -> Forgiving:
    return stream if isinstance(stream, Forgiving) else Forgiving(stream)


def print_bytes(content: bytes) -> None:
    """Prints what is no text; raises UpwashError where standard output does not take all of it."""
    try:
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
    except OSError as error:
        give_up_output()
        raise UpwashError(f"standard output cannot be written ({error.strerror})") from error


def open_closed_streams() -> None:
    """Leads standard streams that are closed nowhere: else the next file that is opened would be one of them."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            _lead_nowhere(number)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def give_up_output() -> None:
    """Leads standard output nowhere, as the interpreter would else try again what is left to print as it ends."""
    with contextlib.suppress(OSError, ValueError):
        _lead_nowhere(sys.stdout.fileno())


def _lead_nowhere(descriptor: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere != descriptor:
        os.dup2(nowhere, descriptor)
        os.close(nowhere)
