"""PROGRAM: process 1 of a container of Docker or Podman.

`python3 -m upwash.real.instances.docker.inside` gets the sockets of the container's one service from the daemon, over
a mounted socket, and runs the service on them: the container needs no network. It reaps all processes, and reports
the service's exit code. The container ends with the service.

`python3 -m upwash.real.instances.docker.inside PROGRAM` prints what the program's service declares, as image labels.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys

from upwash.real.instances.limits import limit_files
from upwash.support.loading import look_here, module_command

HANDOFF = "/run/upwash/handoff.sock"
COMMAND = ("python3", "-P", "-m", "upwash.real.instances.docker.inside")
_SOCKETS = 3  # for the control line, output and callers


def take_over() -> None:
    """Run the service until it has ended."""
    daemon = socket.socket(socket.AF_UNIX)
    daemon.connect(HANDOFF)
    _, inherited, _, _ = socket.recv_fds(daemon, 1, _SOCKETS)
    if len(inherited) < _SOCKETS:
        raise SystemExit("the daemon hung up before it handed over the service's sockets")
    control, output, outside = inherited
    limit_files()
    service = subprocess.Popen(  # noqa: S603 - the service itself
        module_command("upwash.real.instances.instance", str(control), str(outside)),
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        pass_fds=(control, outside),
        start_new_session=True,
    )
    for number in inherited:
        os.close(number)

    def pass_on(number: int, _frame: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(service.pid, number)

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, pass_on)
    code = _code_of(service.pid)
    with contextlib.suppress(OSError):
        daemon.sendall(f"{code}\n".encode())
    os._exit(0)


def _code_of(process_id: int) -> int:
    """The exit code of that process, negative for a signal; other processes are reaped meanwhile."""
    while True:
        ended, status = os.wait()
        if ended == process_id:
            return os.waitstatus_to_exitcode(status)


def describe(program: str) -> None:
    """Print what the program's service declares."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    from upwash.errors import UsageError
    from upwash.rpc.service import load_service, spec_of

    look_here()
    try:
        spec = spec_of(load_service(program))
    except UsageError as error:
        raise SystemExit(str(error)) from error
    told = {
        "upwash.service": spec.name,
        "upwash.methods": ",".join(sorted(spec.methods)),
        "upwash.concurrency": str(spec.concurrency),
        "upwash.python": platform.python_version(),
    }
    with contextlib.suppress(PackageNotFoundError):  # a packaged image has a label for it
        told["upwash.release"] = version("upwash")
    print(json.dumps(told), flush=True)  # noqa: T201 - for the daemon


if __name__ == "__main__":
    if sys.argv[1:]:
        describe(sys.argv[1])
    else:
        take_over()
