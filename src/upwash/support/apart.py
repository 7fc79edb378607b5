"""Code of others in a process of its own, which answers one question at a time, each within a limit of time.

Such code may hold Python's lock for minutes, crash or print its last words: a thread cannot be ended, a process can.
Questions and answers are bytes, each behind its length.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from upwash.support.loading import module_command
from upwash.support.standard_streams import forgiving_streams
from upwash.support.text import signal_name

_LENGTH_BYTES = 4
_LONGEST_ANSWER_BYTES = 65_536
_ORPHAN_S = 60  # for an answer that no asker may wait for any more


class TookTooLong(Exception):
    """Raised for a question whose answer is not there in time; the process is ended."""


class Crashed(Exception):
    """Raised for a process that ended in place of an answer; its message says how."""


class Apart:
    """The process of a module that calls `serve`; it ends with this program, or by `end`."""

    def __init__(self, module: str) -> None:
        self._line, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - a module of this package
                module_command(module, str(theirs.fileno())),
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is for this program
            )

    @property
    def runs(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    def ask(self, question: bytes, *, within_s: float) -> bytes:
        """The answer; raises NoAnswer and Crashed, and the process is gone then."""
        until_s = time.monotonic() + within_s
        with contextlib.ExitStack() as failing:
            failing.callback(self.end)
            try:
                self._line.settimeout(within_s)
                self._line.sendall(len(question).to_bytes(_LENGTH_BYTES, "big") + question)
                length = int.from_bytes(self._read(_LENGTH_BYTES, until_s), "big")
                if length > _LONGEST_ANSWER_BYTES:
                    raise Crashed(f"answered with {length} bytes")
                answer = self._read(length, until_s)
            except TimeoutError:
                raise TookTooLong from None
            except (OSError, EOFError):
                raise Crashed(f"ended its process{self._how()}") from None
            failing.pop_all()
            return answer

    def end(self) -> None:
        """Kill the process; returns when it is gone."""
        self._line.close()
        self._process.kill()
        self._process.wait()

    def _read(self, count: int, until_s: float) -> bytes:
        content = bytearray()
        while len(content) < count:
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            self._line.settimeout(left_s)
            piece = self._line.recv(count - len(content))
            if not piece:
                raise EOFError
            content += piece
        return bytes(content)

    def _how(self) -> str:
        try:
            code = self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            return ""
        return f" by {signal_name(-code)}" if code < 0 else f" with exit code {code}"


def dies_first() -> None:
    """Have Linux, where no memory is left, kill this process before the program that started it."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")


def serve(answer: Callable[[bytes], bytes]) -> None:
    """Answer the questions of the program that started this process, until that program ends."""
    dies_first()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    with forgiving_streams(), socket.socket(fileno=int(sys.argv[1])) as line:
        questions = line.makefile("rb")
        while head := questions.read(_LENGTH_BYTES):
            question = questions.read(int.from_bytes(head, "big"))
            signal.alarm(_ORPHAN_S)  # which ends the process though its code holds Python's lock
            content = answer(question)
            signal.alarm(0)
            with contextlib.suppress(OSError):
                sys.stdout.flush()
                sys.stderr.flush()
            line.sendall(len(content).to_bytes(_LENGTH_BYTES, "big") + content)
