"""Small services that tests start in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Literal

from upwash.service import service

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


@service
class Tuned:
    """Says how it was made."""

    def __init__(self, gain: float, *, mode: Mode = "light", table: Path | None = None) -> None:
        self._made = f"{gain} {mode} {table}"

    def made(self) -> str:
        return self._made


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
