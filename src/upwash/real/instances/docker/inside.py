"""Process 1 of a container of Docker or Podman.

`python3 -m upwash.real.instances.docker.inside` takes over from its daemon the sockets of the one service in the
container, over a socket that is mounted there, and runs that service on them: the container needs no network. It
reaps whatever ends in the container, and reports the exit code of the service. The container ends with the service.

`python3 -m upwash.real.instances.docker.inside PROGRAM` prints what the program's service declares, as the image's
properties.
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
_SOCKETS = 3  # the control line, what the service prints to, where callers come


def take_over() -> None:
    """Runs the service until it has ended."""
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
    for each in inherited:
        os.close(each)

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
    """The code of that process, negative for a signal, once it has ended; of others it reaps what is left."""
    while True:
        ended, status = os.wait()
        if ended == process_id:
            return os.waitstatus_to_exitcode(status)


def describe(program: str) -> None:
    """Prints what the program's service declares."""
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
    with contextlib.suppress(PackageNotFoundError):  # of an image that was packaged, a label says it
        told["upwash.release"] = version("upwash")
    print(json.dumps(told), flush=True)  # noqa: T201 - to whoever runs it


if __name__ == "__main__":
    if sys.argv[1:]:
        describe(sys.argv[1])
    else:
        take_over()
