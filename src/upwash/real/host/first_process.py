"""The first process of a container, which passes signals on to the program and reaps every process that ends there.

The kernel hands the orphans of a container to its process 1. A program that waits for its own children cannot reap
these too: its waits would lose their exit codes. So the program becomes a child of its process 1.
"""

from __future__ import annotations

import os
import signal

_PASSED_ON = (signal.SIGTERM, signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
_SIGNALLED = 128  # the exit code of a shell for a program that a signal ended


def leave_first_process() -> None:
    """Returns in a child process, if this is process 1, and otherwise at once; call it before any thread starts."""
    if os.getpid() == 1:
        go_on_in_child()


def go_on_in_child() -> None:
    """Returns in a child process. The calling process ends with the child's exit code, 128 and more for a signal.

    A container ends with its process 1, and what still runs there with the container.
    """
    watched = {signal.SIGCHLD, *_PASSED_ON}
    signal.pthread_sigmask(signal.SIG_BLOCK, watched)  # they wait until `sigwait` takes them
    program = os.fork()
    if program == 0:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, watched)
        return
    while True:
        number = signal.sigwait(watched)
        if number != signal.SIGCHLD:
            os.kill(program, number)
        elif (code := _reap(program)) is not None:
            os._exit(code if code >= 0 else _SIGNALLED - code)


def _reap(program: int) -> int | None:
    """Reap what has ended; return the exit code of the program if it has, negative for a signal."""
    code = None
    while code is None:
        ended, status = os.waitpid(-1, os.WNOHANG)
        if ended == 0:
            break
        if ended == program:
            code = os.waitstatus_to_exitcode(status)
    return code
