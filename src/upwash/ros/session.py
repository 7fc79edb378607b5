"""A ROS 2 node that spins in a thread of its own until the end of a block."""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from upwash.errors import UsageError
from upwash.support.background import only_logged, thread
from upwash.support.text import printable, worded

_SPIN_S = 0.2  # at most, until the end of the block is noticed
_JOIN_S = 5.0
_log = logging.getLogger("upwash.ros")


@contextlib.contextmanager
def ros_imports() -> Iterator[None]:
    """Imports ROS 2's modules in the block; raises UsageError with the remedy where they cannot be."""
    try:
        yield
    except ImportError as error:
        python = f"{sys.version_info.major}.{sys.version_info.minor}"
        distribution = os.environ.get("ROS_DISTRO", "jazzy")
        raise UsageError(
            f"ROS 2 cannot be imported ({printable(str(error), 200)}): `source /opt/ros/{distribution}/setup.bash`; "
            f"this is Python {python}, and must be the one of that ROS"
        ) from error


@contextlib.contextmanager
def spinning(
    make: Callable[..., Any], *, args: Sequence[str] = (), failed: Callable[[str], None] = _log.warning
) -> Iterator[Any]:
    """The node that `make(context=...)` returns, spinning until the end of the block; `args` are ROS arguments.

    `failed` gets a sentence for each failure of a callback or of rclpy itself. Raises UsageError without ROS, and for
    arguments that ROS refuses.
    """
    with ros_imports():
        import rclpy
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions
    context = rclpy.Context()
    try:
        rclpy.init(args=list(args), context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = make(context=context)
    except Exception as error:
        rclpy.try_shutdown(context=context)
        if isinstance(error, UsageError):
            raise
        raise UsageError(f"ROS 2 refuses to begin: {printable(str(error), 300)}") from error
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    closed = False

    def spin() -> None:
        while not closed:
            try:
                executor.spin_once(timeout_sec=_SPIN_S)
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: BLE001 - such as a message that cannot be decoded
                failed(sentence_of(error))

    spinner = thread(spin, name="ROS 2", failed=only_logged)
    spinner.start()
    try:
        yield node
    finally:
        closed = True
        executor.wake()
        spinner.join(_JOIN_S)
        executor.shutdown(timeout_sec=_SPIN_S)
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def sentence_of(error: Exception) -> str:
    """A failure of ROS's code or of a callback in one line."""
    return printable(worded(error), 300)


def guarded(do: Callable[..., Any], failed: Callable[[str], None]) -> Callable[..., Any]:
    """The same callback, but what it raises goes to `failed` as a sentence."""

    @functools.wraps(do)
    def call(*args: Any) -> Any:
        try:
            return do(*args)
        except Exception as error:  # noqa: BLE001 - no exception may reach the spin
            _log.debug("a callback failed", exc_info=error)
            failed(sentence_of(error))
            return None

    return call
