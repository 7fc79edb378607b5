"""The emulated radios: cables shaped by a table of goodput, or ns-3 in real time.

A shaped cable is as fast as the table says at the drone's distance, and cut out of range. ns-3 has a ghost station
for each drone and server on each server's network.
"""

from __future__ import annotations

import contextlib
import math
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeAlias

from upwash.config.places import true_range_m
from upwash.core.geo import Position, ground_distance_m
from upwash.emulation.field import EmulatedLink
from upwash.emulation.namespaces import LinkEnd, command, give_address, join_by_cable
from upwash.emulation.native import native_program, wifi_of
from upwash.errors import NetworkError
from upwash.sim.radio import read_goodput
from upwash.support.background import thread

_FRAME_PER_PAYLOAD = 1514 / 1448  # bytes of a full TCP segment on the cable by those that goodput counts
_FASTEST_BIT_S = 1e9
_BURST_BYTES = 8_000  # what may pass at once: a few frames
_QUEUE_BYTES = (
    2_000_000  # several photos: one lost here would cost a timeout that no table of goodput knows of
)
_WORTH_A_CHANGE = 0.02  # of the rate


class ShapedRadio:
    """A cable for each link, shaped alike at both ends."""

    lag_s = 0.0  # the kernel shapes

    def __init__(self, links: Iterable[EmulatedLink]) -> None:
        self._links: dict[str, list[_ShapedLink]] = {}
        for link in links:
            join_by_cable(link.drone_end, link.server_end)
            self._links.setdefault(link.drone, []).append(_ShapedLink(link))

    def move(self, drone: str, position: Position) -> None:
        """Shapes the drone's links for its position."""
        for link in self._links[drone]:
            link.move(position)

    def close(self) -> None:
        """Does nothing, as the cables are removed with their namespaces."""


class _ShapedLink:
    def __init__(self, link: EmulatedLink) -> None:
        self._link = link
        self._table = read_goodput(link.server.truth.radio)
        self._rate_bit_s = -1.0
        self._shape(0.0)

    def move(self, position: Position) -> None:
        rate_bit_s = (
            self._goodput_bit_s(ground_distance_m(position, self._link.server_at)) * _FRAME_PER_PAYLOAD
        )
        if abs(rate_bit_s - self._rate_bit_s) > _WORTH_A_CHANGE * self._rate_bit_s or not rate_bit_s:
            self._shape(rate_bit_s)

    def _goodput_bit_s(self, distance_m: float) -> float:
        server = self._link.server
        range_m = true_range_m(server)
        if range_m is not None and distance_m > range_m:
            return 0.0
        if self._table is not None:
            return self._table.at(distance_m)
        return server.bandwidth_bit_s or _FASTEST_BIT_S

    def _shape(self, rate_bit_s: float) -> None:
        if rate_bit_s == self._rate_bit_s:
            return
        self._rate_bit_s = rate_bit_s
        for end in (self._link.drone_end, self._link.server_end):
            queue = ("tc", "-n", end.namespace, "qdisc", "replace", "dev", end.device, "root")
            command(*queue, *_discipline(rate_bit_s))


def _discipline(rate_bit_s: float) -> tuple[str, ...]:
    """A queue of that rate; rate 0 loses every frame."""
    if rate_bit_s == 0:
        return ("blackhole",)
    return ("tbf", "rate", f"{rate_bit_s:.0f}bit", "burst", str(_BURST_BYTES), "limit", str(_QUEUE_BYTES))


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
    """One ns-3 process with all stations; its devices in the namespaces are removed with it."""

    def __init__(self, links: Sequence[EmulatedLink]) -> None:
        self.lag_s = 0.0
        self._links: dict[str, list[EmulatedLink]] = {}
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
        """Moves the drone's stations; raises NetworkError if the process has ended."""
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

    def _begin(self, links: Sequence[EmulatedLink]) -> None:
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


def _description(links: Sequence[EmulatedLink]) -> Iterator[str]:
    for link in links:
        cell = link.server.name
        yield " ".join(("cell", cell, *wifi_of(link.server).words()))
        yield _station(_server_end(link), cell, link.server_at)
    for link in links:
        yield _station(link.drone_end, link.server.name, Position(0.0, 0.0))


def _station(end: LinkEnd, cell: str, position: Position) -> str:
    return f"station {_name(end)} {cell} /run/netns/{end.namespace} {end.device} {_place(position)}"


def _name(end: LinkEnd) -> str:
    return f"{end.namespace}/{end.device}"


def _place(position: Position) -> str:
    return f"{position.east_m:.2f} {position.north_m:.2f}"


def _server_end(link: EmulatedLink) -> LinkEnd:
    return LinkEnd(link.server_end.namespace, _SERVER_DEVICE, link.server_end.address)


EmulatedRadio: TypeAlias = ShapedRadio | GhostRadio
