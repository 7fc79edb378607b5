"""Process 1 of a container: closes it off, runs the one service in it, and joins that to the daemon outside.

`python -m upwash.real.instances.lxd.init`, with its control credentials in the environment. The service is a
process as any other service instance (`instance.py`), of a user without rights; what it and its daemon say to each
other passes through here, as does what it prints. When the daemon hangs up, or the service ends, the container ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import socket
import subprocess

from upwash.core.admission.limits import Allowance
from upwash.real.instances.control import Failed, Printed, ServiceEnded, line
from upwash.real.instances.lxd.credentials import (
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
CREDENTIALS = "UPWASH_LEASH"  # as containers of earlier versions have it
SCRATCH_BYTES = (
    "UPWASH_SCRATCH_BYTES"  # that the service may write to a folder, in memory and part of the container's
)

_SERVICE_USER = 1000
_HANDSHAKE_S = 2.0
_LAST_OUTPUT_S = 1.0  # a child of the service may hold the pipe open
_CHUNK_BYTES = 16384
_PASSED_BYTES_S = 2.0**18  # of what the service prints
_PASSED_AT_ONCE_BYTES = 2**21
_SCRATCH_FOLDERS = ("/tmp", "/dev/shm")  # noqa: S108 - the container's own, and mounted here

# Nothing is asked of anyone from in here: only who called gets an answer.
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
        """Starts it; returns its control line and its output."""
        control, their_control = socket.socketpair()
        output, their_output = socket.socketpair()
        # Process 1 reaps whatever ends in the container, so it cannot leave that to asyncio.
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
        """Returns its exit code, negative for a signal, when it has ended."""
        return await asyncio.shield(self._ended)

    def _reap(self) -> None:
        with contextlib.suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                if found[0] == self._process_id and not self._ended.done():
                    self._ended.set_result(os.waitstatus_to_exitcode(found[1]))


async def stand() -> None:
    """Waits for the daemon, runs the service for it, and returns when either is gone."""
    credentials = ControlCredentials.from_text(os.environ.pop(CREDENTIALS))
    problem = await asyncio.to_thread(close_off)
    hear, tell = await daemon(credentials)
    if problem:
        tell.write(line(Failed(problem)))
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
    """Shuts the network but for the service's ports, and gives the service memory to write to; or says why not."""
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
    """The line to the first who holds the credentials; nobody else is heard, then or later."""
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
    """Line by line, as others write to the same writer; the daemon hangs up on a line that is too long."""
    with contextlib.suppress(OSError):
        async for text in lines_of(reader):
            writer.write(text)
            await writer.drain()


async def _pass_on_output(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """So much of it; the service does not wait until the daemon takes the rest."""
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
    """Ends the container, by which the daemon starts the service again where it is asked for."""
    os._exit(1)


def main() -> None:
    """Stands until the container has nothing left to do; as process 1 it takes everything else along."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGPWR, signal.SIGRTMIN + 3):
        signal.signal(number, lambda *_: os._exit(0))
    asyncio.run(stand())
    os._exit(0)


if __name__ == "__main__":
    main()
