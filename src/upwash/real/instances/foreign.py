"""A service's program in any language, which answers calls over its standard input and output.

docs/services.md describes its frames.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from typing import IO

import msgspec

from upwash.errors import UsageError
from upwash.real.link.direct import BESIDE_BYTES, frame, read_frame
from upwash.rpc.service import Method, ServiceFault
from upwash.support.background import thread
from upwash.support.text import printable, signal_name

_LONGEST_REASON = 1000
_ENDS_S = 1.0  # once it has hung up


class ProgramCall(msgspec.Struct, frozen=True):
    """To the program: compute this, and answer with the same id."""

    id: int
    method: str
    arguments: msgspec.Raw


class ProgramSettings(msgspec.Struct, frozen=True):
    """To the program, first: the settings of its service."""

    settings: dict[str, object]


class ProgramAnswer(msgspec.Struct, frozen=True, omit_defaults=True):
    """From the program: the value or fault of the call with that id; id 0 stands for its settings."""

    id: int
    value: msgspec.Raw | msgspec.UnsetType = msgspec.UNSET
    fault: ServiceFault | msgspec.UnsetType = msgspec.UNSET


_encoder = msgspec.msgpack.Encoder()
_answer = msgspec.msgpack.Decoder(ProgramAnswer)


class ForeignProgram:
    """Starts the program, and has it compute calls; raises UsageError if it does not start.

    The program gets as many calls at a time as the service declares. If it ends or sends an invalid answer, this
    process ends too, with the program's exit code; the daemon starts it again.
    """

    def __init__(
        self, command: Sequence[str], settings: Mapping[str, object], *, max_message_bytes: int
    ) -> None:
        self._most_bytes = max_message_bytes + BESIDE_BYTES
        self._numbers = itertools.count(1)
        self._writing = threading.Lock()
        self._waiting: dict[int, Future[ProgramAnswer]] = {}
        try:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)  # noqa: S603
        except OSError as error:
            raise UsageError(f"{command[0]} cannot be run: {error.strerror}") from error
        try:
            self._begin(command[0], settings)
        except BaseException:
            self._process.kill()
            with contextlib.suppress(OSError), self._process:  # which closes its pipes, and waits for it
                pass
            raise
        thread(
            self._listen, name="foreign program", failed=lambda error: self._end(f"a defect: {error}")
        ).start()

    def _begin(self, program: str, settings: Mapping[str, object]) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None  # noqa: S101 - they are pipes
        self._input, self._output = self._process.stdin, self._process.stdout
        try:
            self._write(frame(ProgramSettings(dict(settings))))
            answer = self._read(self._output)
        except (OSError, EOFError, ValueError) as error:
            why = str(error)
            with contextlib.suppress(subprocess.TimeoutExpired):
                why = f"it ended with code {self._process.wait(_ENDS_S)}"
            raise UsageError(f"{program} did not answer to its settings: {why}") from error
        if answer.fault is not msgspec.UNSET:
            raise UsageError(f"{program}: {printable(answer.fault.message, _LONGEST_REASON)}")

    def perform(self, method: Method, request: bytes) -> tuple[str, bytes]:
        """The profile key of a call and its encoded reply, computed by the program."""
        try:
            key = method.key_of(request)
        except msgspec.MsgspecError as error:
            fault = ServiceFault("builtins:TypeError", f"{method.name}(): {error}")
            return "", _encoder.encode({"fault": fault})
        number, answered = next(self._numbers), Future[ProgramAnswer]()
        self._waiting[number] = answered
        self._write(frame(ProgramCall(number, method.name, msgspec.Raw(request))))
        answer = answered.result()
        is_value = answer.fault is msgspec.UNSET
        return key, _encoder.encode({"value": answer.value} if is_value else {"fault": answer.fault})

    def _write(self, text: bytes) -> None:
        with self._writing:
            self._input.write(text)
            self._input.flush()

    def _read(self, output: IO[bytes]) -> ProgramAnswer:
        try:
            answer = _answer.decode(read_frame(output, most_bytes=self._most_bytes))
        except RecursionError:
            raise ValueError("an answer that is nested too deeply") from None
        if (answer.value is msgspec.UNSET) == (answer.fault is msgspec.UNSET):
            raise ValueError("an answer must have either a value or a fault")
        return answer

    def _listen(self) -> None:
        why = ""
        try:
            while True:
                answer = self._read(self._output)
                self._waiting.pop(answer.id).set_result(answer)
        except KeyError as error:
            why = f"the program answered a call that was not made: {error}"
        except (OSError, EOFError):
            pass  # it ends
        except ValueError as error:
            why = f"the program sent no valid answer: {error}"
        self._end(why)

    def _end(self, why: str) -> None:
        """End this process with the program's exit code, and the program if it is still running."""
        if why:
            self._process.kill()
        code = self._process.wait()
        if code < 0 and not why:
            why = f"the program was killed by {signal_name(-code)}"
        if why:
            print(printable(why, _LONGEST_REASON), flush=True)  # noqa: T201 - for the log of who started this
        os._exit(1 if why else code)
