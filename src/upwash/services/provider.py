"""Sessions of onnxruntime on a provider (processor or CUDA), or the provider's own reason why there is none.

NVIDIA's libraries may be packages beside onnxruntime, where no linker searches: onnxruntime loads them on request.
"""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Literal

from upwash.errors import ModelError, UsageError
from upwash.services.heads import MOST_VALUES
from upwash.services.model_file import without_places
from upwash.support.loading import install_extra, pip
from upwash.support.text import words_of

if TYPE_CHECKING:
    import onnxruntime

Provider = Literal["auto", "cpu", "cuda"]

_PROCESSOR, _CARD = "CPUExecutionProvider", "CUDAExecutionProvider"
# By default each new size of a picture is tried out for a second, to choose the fastest way of each layer.
_OPTIONS = {_CARD: {"cudnn_conv_algo_search": "HEURISTIC"}}
_KINDS = {"tensor(float16)": "float16", "tensor(int64)": "int64"}
_SIDE_PX = 640  # of a picture where the network takes any: as large as those of mode `heavy`
_DEVICES = (
    "/dev/nvidiactl",
    "/dev/nvgpu",
    "/dev/nvmap",
    "/dev/dxg",
)  # of a machine with a card, one of these
_STDERR = 2
_MOST_PRINTED_BYTES = 2**16
_LONGEST_REASON = 1000  # characters
_COLOURS = re.compile(r"\x1b\[[\d;]*m")
# The prefix of a reason: the time, places in onnxruntime's source, the kind of the error. Only the start of a word is
# tried, as trying each letter of a long one takes seconds.
_BEFORE_REASONS = re.compile(
    r"(?<!\S)(\S+ \S+ \[\w:onnxruntime:[^\]]*\]|\S*/onnxruntime_src/.*?(?=\w+ failure \d|: FAIL :))"
    r"|(\[ONNXRuntimeError\] : \d+ )?: FAIL :"
)


def open_session(model: Path, *, threads: int, provider: Provider) -> onnxruntime.InferenceSession:
    """A session of the model; raises ModelError for its file and UsageError for the provider.

    With `auto` it computes on a card if onnxruntime can use one. If onnxruntime is made for cards and cannot use one,
    the reason is printed, and it computes on the processor. Without a card it loads nothing of CUDA, which takes
    memory.
    """
    import onnxruntime

    is_for_cards = _CARD in onnxruntime.get_available_providers()
    if provider == "cpu" or (provider == "auto" and not is_for_cards):
        return _session(model, threads, _PROCESSOR)
    try:
        if not is_for_cards:
            raise UsageError(
                'provider = "cuda" is not in the onnxruntime that is installed; for cuda: '
                f"`{pip('uninstall onnxruntime')}`, then `{install_extra('detector-gpu')}`"
            )
        if provider == "auto" and not any(map(os.path.exists, _DEVICES)):
            raise UsageError(
                "no graphics card is shown to this process (`devices` of a service in a sandbox or container)"
            )
        return _session_on_card(model, threads, repeats=provider == "cuda")
    except UsageError as error:
        if provider == "cuda":
            raise
        said = f"warning: {error}; the detector computes on the processor"
        print(said, file=sys.stderr, flush=True)  # noqa: T201 - for the log of who starts it
        return _session(model, threads, _PROCESSOR)


def _session_on_card(model: Path, threads: int, *, repeats: bool) -> onnxruntime.InferenceSession:
    import onnxruntime

    with redirect_stdout(StringIO()):  # onnxruntime says below what it still misses
        onnxruntime.preload_dlls()
    with _printed_errors(repeats=repeats) as printed:  # onnxruntime does not raise if a library is missing
        try:
            session = _session(model, threads, _CARD)
        except ModelError as error:
            _session(model, threads, _PROCESSOR)  # raises too if the cause is the model
            raise _unusable(str(error.__cause__)) from error
    if _CARD not in session.get_providers():
        raise _unusable(printed())
    try:
        _run_once(session)
    except Exception as error:  # onnxruntime's exceptions have no common base
        if _can_run(_session(model, threads, _PROCESSOR)):
            raise _unusable(str(error)) from error
    return session


def _can_run(session: onnxruntime.InferenceSession) -> bool:
    try:
        _run_once(session)
    except Exception:  # noqa: BLE001 - as above
        return False
    return True


def _run_once(session: onnxruntime.InferenceSession) -> None:
    """Runs the network on a grey picture: a card that is too old or too small fails only there."""
    import numpy as np

    shapes = [node.shape for node in (*session.get_inputs(), *session.get_outputs())]
    if any(math.prod(side for side in shape if isinstance(side, int)) > MOST_VALUES for shape in shapes):
        return  # it will be refused
    given = {}
    for node in session.get_inputs():
        free = (1, *[_SIDE_PX] * len(node.shape))  # for what the network leaves open
        shape = [
            side if isinstance(side, int) else any_ for side, any_ in zip(node.shape, free, strict=False)
        ]
        given[node.name] = np.ones(shape, _KINDS.get(node.type, "float32"))
    session.run(None, given)


def _session(model: Path, threads: int, provider: str) -> onnxruntime.InferenceSession:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3  # errors only: they are raised too
    try:
        return onnxruntime.InferenceSession(
            str(model),
            options,
            providers=[provider],
            provider_options=[_OPTIONS.get(provider, {})],
            enable_fallback=False,
        )
    except Exception as error:  # onnxruntime's exceptions have no common base
        raise ModelError(model, "", f"onnxruntime cannot load it ({words_of(str(error))})") from error


def _unusable(why: str) -> UsageError:
    why = _BEFORE_REASONS.sub(" ", _COLOURS.sub(" ", why))
    why = " ".join(words_of(without_places(why)).split())[:_LONGEST_REASON]
    return UsageError(
        f'provider = "cuda" cannot be used here: {why or "onnxruntime does not say why"}; install what it names, and '
        'show the card to a service in a sandbox (`devices`), or say provider = "cpu"'
    )


@contextmanager
def _printed_errors(*, repeats: bool) -> Iterator[Callable[[], str]]:
    """Capture what this process writes to standard error in the block; `repeats` writes it there afterwards."""
    sys.stderr.flush()
    ours, text = os.dup(_STDERR), b""
    with TemporaryFile() as kept:  # a sandbox has no memfd_create
        os.dup2(kept.fileno(), _STDERR)
        try:
            yield lambda: text.decode(errors="replace")
        finally:
            sys.stderr.flush()
            os.dup2(ours, _STDERR)
            text = os.pread(kept.fileno(), _MOST_PRINTED_BYTES, 0)
            os.close(ours)
            if repeats:
                os.write(_STDERR, text)
