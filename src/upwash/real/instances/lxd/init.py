"""PROGRAM: process 1 of a container of LXD or Incus, between the daemon and the one service inside.

`python -m upwash.real.instances.lxd.init` gets its control credentials from the environment. It closes the network,
and runs the service as an instance (`instance.py`) of a user without rights. The control line and the output pass
through here. The container ends when the daemon hangs up, or the service ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess

from upwash.core.admission.limits import Allowance
from upwash.real.instances.control import InstanceFailed, Printed, ServiceEnded, line
from upwash.real.instances.control_credentials import (
    CONTROL_PORT,
    SERVICE_PORT,
    ControlCredentials,
    notice_silence,
)
from upwash.real.instances.output import chunks_of, last_of
from upwash.support.background import first, start
from upwash.support.lines import lines_of
from upwash.support.loading import module_command

# In the environment of process 1:
CREDENTIALS = "UPWASH_LEASH"  # the name in containers of earlier versions
SCRATCH_BYTES = "UPWASH_SCRATCH_BYTES"  # the size of each folder for files, in the container's memory

_SERVICE_USER = 1000
_HANDSHAKE_S = 2.0
_LAST_OUTPUT_S = 1.0  # a child of the service may hold the pipe open
_CHUNK_BYTES = 16384
_PASSED_BYTES_S = 2.0**18  # of output
_PASSED_AT_ONCE_BYTES = 2**21
_SCRATCH_FOLDERS = ("/tmp", "/dev/shm")  # noqa: S108 - the container's own, and mounted here

# Only replies leave the container.
_FIREWALL = f"""
table inet upwash {{
    chain incoming {{
        type filter hook input priority 0; policy drop
        iif lo accept
        ct state established accept
        tcp dport {{ {SERVICE_PORT}, {CONTROL_PORT} }} accept
    }}
    chain outgoing {{
        type filter hook output priority 0; policy drop
        oif lo accept
        ct state established accept
    }}
}}
"""
_WITHOUT_RIGHTS = (
    "setpriv",
    f"--reuid={_SERVICE_USER}",
    f"--regid={_SERVICE_USER}",
    "--clear-groups",
    "--inh-caps=-all",
    "--bounding-set=-all",
    "--no-new-privs",
)

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Service:
    """The service's process, its control line and its output."""

    def __init__(self) -> None:
        self._ended: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self._process_id = 0

    async def start(self) -> tuple[Streams, Streams]:
        """Start the service; returns its control line and its output."""
        control, their_control = socket.socketpair()
        output, their_output = socket.socketpair()
        # Process 1 reaps all processes of the container, which asyncio would not.
        asyncio.get_running_loop().add_signal_handler(signal.SIGCHLD, self._reap)
        with their_control, their_output:
            process = subprocess.Popen(  # noqa: ASYNC220, S603 - nothing else runs here yet
                (
                    *_WITHOUT_RIGHTS,
                    *module_command("upwash.real.instances.instance", str(their_control.fileno())),
                ),
                stdin=subprocess.DEVNULL,
                stdout=their_output.fileno(),
                stderr=their_output.fileno(),
                pass_fds=(their_control.fileno(),),
                start_new_session=True,
            )
        self._process_id = process.pid
        return await asyncio.open_connection(sock=control), await asyncio.open_connection(sock=output)

    async def ended(self) -> int:
        """The service's exit code once it has ended; negative for a signal."""
        return await asyncio.shield(self._ended)

    def _reap(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                if found[0] == self._process_id and not self._ended.done():
                    self._ended.set_result(os.waitstatus_to_exitcode(found[1]))


async def stand() -> None:
    """Wait for the daemon, and run the service until one of the two is gone."""
    credentials = ControlCredentials.from_text(os.environ.pop(CREDENTIALS))
    problem = await asyncio.to_thread(close_off)
    hear, tell = await daemon(credentials)
    if problem:
        tell.write(line(InstanceFailed(problem)))
        await tell.drain()
        tell.close()
        return
    service = Service()
    (reports, orders), (prints, _) = await service.start()
    reporting = start(_pass_on_lines(reports, tell), name="the service's reports", failed=_end_container)
    printing = start(_pass_on_output(prints, tell), name="the service's output", failed=_end_container)
    code = await first(_pass_on(hear, orders), service.ended())
    if code is not None:
        await asyncio.wait([reporting, printing], timeout=_LAST_OUTPUT_S)
        with contextlib.suppress(OSError):
            tell.write(line(ServiceEnded(code)))
            await tell.drain()
            tell.close()
            await tell.wait_closed()


def close_off() -> str:
    """Close the network except the two ports, and mount the folders for files; returns why that failed, or ""."""
    commands: list[tuple[str, ...]] = [("nft", "-f", "-")]
    size = os.environ[SCRATCH_BYTES]
    for folder in _SCRATCH_FOLDERS:
        os.makedirs(folder, exist_ok=True)  # noqa: PTH103 - pathlib is not imported here
        commands.append(
            ("mount", "-t", "tmpfs", "-o", f"size={size},mode=1777,nosuid,nodev", "tmpfs", folder)
        )
    for command in commands:
        try:
            subprocess.run(command, input=_FIREWALL, text=True, capture_output=True, check=True)  # noqa: S603
        except FileNotFoundError:
            return (
                f"the image has no {command[0]}: install Debian's package of it and package the service again"
            )
        except subprocess.CalledProcessError as error:
            return f"the container cannot be closed off: {' '.join(command)}: {error.stderr.strip()}"
    return ""


async def daemon(credentials: ControlCredentials) -> Streams:
    """The connection of the first holder of the credentials; all others are closed."""
    found: asyncio.Future[Streams] = asyncio.get_running_loop().create_future()

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if found.done():
            writer.close()
            return
        notice_silence(writer.get_extra_info("socket"))
        found.set_result((reader, writer))

    door = await asyncio.start_server(
        connected,
        "0.0.0.0",  # noqa: S104 - every interface of the container's own
        CONTROL_PORT,
        ssl=credentials.context(is_server=True),
        ssl_handshake_timeout=_HANDSHAKE_S,
    )
    streams = await found
    door.close()
    return streams


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while chunk := await reader.read(_CHUNK_BYTES):
            writer.write(chunk)
            await writer.drain()


async def _pass_on_lines(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Pass on whole lines, since output goes to the same writer; the daemon hangs up on too long a line."""
    with contextlib.suppress(OSError):
        async for text in lines_of(reader):
            writer.write(text)
            await writer.drain()


async def _pass_on_output(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Pass on output up to a rate, and drop the rest: the service never waits for the daemon."""
    passed, now_s = Allowance(_PASSED_BYTES_S, at_once=_PASSED_AT_ONCE_BYTES), asyncio.get_running_loop().time
    left_out, last = 0, b""
    with contextlib.suppress(OSError):
        async for chunk in chunks_of(reader):
            if passed.take(len(chunk), now_s=now_s()):
                writer.write(line(Printed(chunk, left_out)))
                await writer.drain()
                left_out, last = 0, b""
            else:
                left_out, last = left_out + len(chunk), last_of(last + chunk)
        if last:
            writer.write(line(Printed(last, left_out - len(last))))
            await writer.drain()


def _end_container(_: Exception) -> None:
    """End the container after a defect; the daemon starts the service again on request."""
    os._exit(1)


def main() -> None:
    """Run until the daemon or the service is gone; the end of process 1 ends all others."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGPWR, signal.SIGRTMIN + 3):
        signal.signal(number, lambda *_: os._exit(0))
    asyncio.run(stand())
    os._exit(0)


if __name__ == "__main__":
    main()
