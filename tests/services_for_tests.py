"""Small services that tests start in processes of their own."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Literal

from upwash.rpc.service import service

Mode = Literal["light", "heavy"]


class Overheated(Exception):
    def __init__(self, temperature_c: float) -> None:
        super().__init__(f"{temperature_c} °C")


@service(profile_by="mode")
class Workbench:
    def echo(self, data: bytes) -> bytes:
        return data

    def process_id(self) -> int:
        return os.getpid()

    def work(self, mode: Mode) -> str:
        return mode

    def pause(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def mutter(self, words: str) -> None:
        print(words)  # noqa: T201 - without a flush

    def fail(self) -> None:
        raise Overheated(91.5)

    def leave(self) -> None:
        sys.exit("the service wants to end")

    def crash(self) -> None:
        os._exit(3)

    def crash_once(self, marker: str) -> str:
        if not Path(marker).exists():
            Path(marker).touch()
            os._exit(3)
        return "survived"

    def hang_once(self, marker: str) -> str:
        if not Path(marker).exists():
            Path(marker).touch()
            time.sleep(60.0)
        return "survived"

    def spawn(self) -> int:
        """Leaves a process behind that ignores SIGTERM; returns its id when it does."""
        script = "import signal, time; signal.signal(15, signal.SIG_IGN); print(flush=True); time.sleep(60)"
        child = subprocess.Popen([sys.executable, "-S", "-c", script], stdout=subprocess.PIPE)
        assert child.stdout is not None
        child.stdout.readline()
        return child.pid

    def say(self, text: str) -> None:
        """As a library's log or a crash's last words do."""
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    def print_without_end(self, length: int) -> None:
        """As progress bars do, which return the carriage and never end the line."""
        sys.stdout.write("." * length + "\r")
        sys.stdout.flush()


@service(concurrency=2)
class Duet:
    """Computes for two at a time: one alone waits for the other."""

    def __init__(self) -> None:
        self._both = threading.Barrier(2, timeout=10.0)
        self._counting = threading.Lock()
        self._playing = self._most = 0

    def play(self) -> int:
        """Returns once another call is under way too; says how many ever were."""
        with self._counting:
            self._playing += 1
            self._most = max(self._most, self._playing)
        self._both.wait()
        with self._counting:
            self._playing -= 1
            return self._most


@service
class Tuned:
    """Says how it was made."""

    def __init__(self, gain: float, *, mode: Mode = "light", table: Path | None = None) -> None:
        self._made = f"{gain} {mode} {table}"

    def made(self) -> str:
        return self._made


@service
class Tuner:
    """Uses another service."""

    def __init__(self, tuned: Tuned, *, note: str) -> None:
        self._tuned, self._note = tuned, note

    def made(self) -> str:
        return f"{self._note}: {self._tuned.made()}"


@service
class Unstartable:
    def __init__(self) -> None:
        raise OSError("model.onnx is missing")

    def nothing(self) -> None:
        """Never reached."""


@service
class SlowToStart:
    def __init__(self) -> None:
        Path(os.environ["PROCESS_ID_FILE"]).write_text(f"{os.getpid()}\n")
        time.sleep(60.0)

    def nothing(self) -> None:
        """Never reached."""


@service
class Vandal:
    """Does what a service must not get away with."""

    def identity(self) -> list[int]:
        """Its user, and whether it holds any capability."""
        status = Path("/proc/self/status").read_text()
        capabilities = [int(line.split()[1], 16) for line in status.splitlines() if line.startswith("Cap")]
        return [os.getuid(), sum(capabilities)]

    def reach(self, host: str, port: int) -> str:
        """What comes of an attempt to talk to someone."""
        try:
            with socket.create_connection((host, port), timeout=1.0):
                return "connected"
        except OSError as error:
            return type(error).__name__

    def eat_memory(self) -> None:
        """Takes memory until it gets no more."""
        hoard = []
        while True:
            hoard.append(bytearray(os.urandom(2**20)) * 16)

    def fork_without_end(self) -> int:
        """Starts processes that stay until it may start no more; returns how many those were."""
        script = "import time; time.sleep(60)"
        children = 0
        try:
            while children < 10_000:
                subprocess.Popen([sys.executable, "-S", "-c", script])
                children += 1
        except OSError:
            pass
        return children

    def fill_disk(self) -> int:
        """Writes wherever it may until it may no more; returns how many bytes those were."""
        written = 0
        for folder, _, _ in os.walk("/"):
            if folder.startswith(("/proc", "/sys")) or not os.access(folder, os.W_OK):
                continue
            try:
                with Path(folder, "filling").open("wb", buffering=0) as file:
                    while written < 2**32:
                        written += file.write(bytes(2**20))
            except OSError:
                pass
        return written


@service
class Halve:
    """Sends the first half; the first word may say something else."""

    def echo(self, data: bytes) -> bytes:
        match data[:5]:
            case b"raise":
                raise Overheated(91.5)
            case b"crash":
                os._exit(3)
            case b"hangs":
                time.sleep(60.0)
            case b"grows":
                return data * 2
            case b"equal":
                return data
        return data[: len(data) // 2]


@service(before_sending=Halve)
class Carrier:
    def echo(self, data: bytes, times: int = 1) -> bytes:
        return data * times
