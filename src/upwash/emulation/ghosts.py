"""The radio as ns-3 simulates it in real time: a ghost station for each drone and server on each server's network."""

from __future__ import annotations

import contextlib
import math
import subprocess
from collections.abc import Iterator, Sequence

from upwash.core.geo import Position
from upwash.emulation.field import Link
from upwash.emulation.namespaces import End, give_address
from upwash.emulation.native import native_program, wifi_of
from upwash.errors import NetworkError
from upwash.support.background import thread

_PREFIX_BITS = 24
_SERVER_DEVICE = "air"  # one for all drones, as they share the network
# Else it lags by tens of milliseconds as soon as others compute. In the first version of control groups real-time
# priority may be allotted to groups, and all of it belongs to the outermost.
_OUTERMOST = "/sys/fs/cgroup/cpu"
_AHEAD_OF_OTHERS = (
    *("sh", "-c"),
    f'if [ -e {_OUTERMOST}/cpu.rt_runtime_us ]; then echo 0 >{_OUTERMOST}/cgroup.procs; fi; exec chrt --fifo 50 "$@"',
    "sh",
)
_STOP_S = 2.0


class GhostRadio:
    """One ns-3 process with all stations; its devices in the namespaces go with it."""

    def __init__(self, links: Sequence[Link]) -> None:
        self.lag_s = 0.0
        self._links: dict[str, list[Link]] = {}
        for link in links:
            self._links.setdefault(link.drone, []).append(link)
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [*_AHEAD_OF_OTHERS, str(native_program("ghosts"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            self._begin(links)
        except BaseException:
            self.close()
            raise

    def move(self, drone: str, position: Position) -> None:
        """Moves the drone's stations; raises NetworkError where the process has ended."""
        for link in self._links[drone]:
            self._tell(f"move {_name(link.drone_end)} {_place(position)}")

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None and self._process.stdout is not None  # noqa: S101
        with contextlib.suppress(OSError):
            self._process.stdin.close()  # which it takes for its own end
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _begin(self, links: Sequence[Link]) -> None:
        ends = {_name(end): end for link in links for end in (link.drone_end, _server_end(link))}
        self._tell("\n".join(dict.fromkeys(_description(links))))
        self._tell("go")
        assert self._process.stdout is not None  # noqa: S101
        if self._process.stdout.readline().strip() != "ready":
            raise NetworkError(f"ns-3 did not start (exit code {self._process.wait()})")
        for end in ends.values():
            give_address(end, prefix_bits=_PREFIX_BITS)
        thread(self._watch_lag, name="watch of ns-3's lag", failed=self._lose_sight).start()

    def _watch_lag(self) -> None:
        assert self._process.stdout is not None  # noqa: S101
        for line in self._process.stdout:
            _, _, lag_s = line.partition("lag ")
            self.lag_s = max(self.lag_s, float(lag_s))

    def _lose_sight(self, _: Exception) -> None:
        self.lag_s = math.inf  # an unmeasured lag is not within the limit

    def _tell(self, line: str) -> None:
        assert self._process.stdin is not None  # noqa: S101
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise NetworkError(f"ns-3 has ended (exit code {self._process.wait()})") from error


def _description(links: Sequence[Link]) -> Iterator[str]:
    """The lines that say what there is, some more than once."""
    for link in links:
        cell = link.server.name
        yield " ".join(("cell", cell, *wifi_of(link.server).words()))
        yield _station(_server_end(link), cell, link.server_at)
    for link in links:
        yield _station(link.drone_end, link.server.name, Position(0.0, 0.0))


def _station(end: End, cell: str, position: Position) -> str:
    return f"station {_name(end)} {cell} /run/netns/{end.namespace} {end.device} {_place(position)}"


def _name(end: End) -> str:
    return f"{end.namespace}/{end.device}"


def _place(position: Position) -> str:
    return f"{position.east_m:.2f} {position.north_m:.2f}"


def _server_end(link: Link) -> End:
    return End(link.server_end.namespace, _SERVER_DEVICE, link.server_end.address)
