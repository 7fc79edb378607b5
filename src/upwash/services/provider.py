"""Sessions of onnxruntime on a provider (processor or CUDA), or the provider's own reason why there is none.

NVIDIA's libraries may be packages beside onnxruntime, where no linker searches: onnxruntime loads them on request.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from upwash.errors import ModelError, UsageError
from upwash.support.text import words_of

if TYPE_CHECKING:
    import onnxruntime

Provider = Literal["auto", "cpu", "cuda"]

_PROCESSOR, _CARD = "CPUExecutionProvider", "CUDAExecutionProvider"
_STDERR = 2
_MOST_PRINTED_BYTES = 2**16
_LONGEST_REASON = 1000  # characters
_COLOURS = re.compile(r"\x1b\[[\d;]*m")
# The prefix of a reason: the time, places in onnxruntime's source, the kind of the error. Only the start of a word is
# tried, as trying each letter of a long one takes seconds.
_BEFORE_REASONS = re.compile(
    r"(?<!\S)(\S+ \S+ \[\w:onnxruntime:[^\]]*\]|\S*/onnxruntime_src/.*?(?=\w+ failure \d|: FAIL :))|: FAIL :"
)


def open_session(model: Path, *, threads: int, provider: Provider) -> onnxruntime.InferenceSession:
    """A session of the model; raises ModelError for its file and UsageError for the provider.

    With `auto` it computes on a card if onnxruntime can use one. If onnxruntime is made for cards and cannot use one,
    the reason is printed, and it computes on the processor.
    """
    import onnxruntime

    is_for_cards = _CARD in onnxruntime.get_available_providers()
    if provider == "cpu" or (provider == "auto" and not is_for_cards):
        return _session(model, threads, _PROCESSOR)
    try:
        if not is_for_cards:
            raise UsageError(
                'provider = "cuda" is not in the onnxruntime that is installed; for cuda: '
                "`pip uninstall onnxruntime`, then `pip install 'upwash[detector-gpu]'`"
            )
        return _session_on_card(model, threads)
    except UsageError as error:
        if provider == "cuda":
            raise
        said = f"warning: {error}; the detector computes on the processor"
        print(said, file=sys.stderr, flush=True)  # noqa: T201 - for the log of who starts it
        return _session(model, threads, _PROCESSOR)


def is_on_card(session: onnxruntime.InferenceSession) -> bool:
    """Whether the session computes on a card."""
    return _CARD in session.get_providers()


def _session_on_card(model: Path, threads: int) -> onnxruntime.InferenceSession:
    import onnxruntime

    with redirect_stdout(StringIO()):  # onnxruntime says below what it still misses
        onnxruntime.preload_dlls()
    with _printed_errors() as printed:  # onnxruntime does not raise if a library is missing
        try:
            session = _session(model, threads, _CARD)
        except ModelError as error:
            _session(model, threads, _PROCESSOR)  # raises too if the cause is the model
            raise _unusable(str(error.__cause__)) from error
    if not is_on_card(session):
        raise _unusable(printed())
    return session


def _session(model: Path, threads: int, provider: str) -> onnxruntime.InferenceSession:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3  # errors only: they are raised too
    try:
        return onnxruntime.InferenceSession(str(model), options, providers=[provider], enable_fallback=False)
    except Exception as error:  # onnxruntime's exceptions have no common base
        raise ModelError(model, "", f"onnxruntime cannot load it ({words_of(str(error))})") from error


def _unusable(why: str) -> UsageError:
    why = " ".join(words_of(_BEFORE_REASONS.sub(" ", _COLOURS.sub(" ", why))).split())[:_LONGEST_REASON]
    return UsageError(
        f'provider = "cuda" cannot be used here: {why or "onnxruntime does not say why"}; install what it names, and '
        'show the card to a service in a sandbox (`devices`), or say provider = "cpu"'
    )


@contextmanager
def _printed_errors() -> Iterator[Callable[[], str]]:
    """Capture what this process writes to standard error in the block, and write it there afterwards."""
    sys.stderr.flush()
    ours, kept = os.dup(_STDERR), os.memfd_create("stderr")
    os.dup2(kept, _STDERR)
    text = b""
    try:
        yield lambda: text.decode(errors="replace")
    finally:
        sys.stderr.flush()
        os.dup2(ours, _STDERR)
        text = os.pread(kept, _MOST_PRINTED_BYTES, 0)
        os.close(kept)
        os.close(ours)
        os.write(_STDERR, text)
