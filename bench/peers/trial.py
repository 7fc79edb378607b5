"""One trial, enclosed: `python -m bench.peers.trial ORDER`. It leaves its figures in the order's folder."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
from bench.peers.calls import PERIOD_S
from bench.peers.computation import LATE_FILE
from bench.peers.link import dark, make_link
from bench.peers.order import FIGURES, Figures, Order, read_order
from bench.peers.programs import Server, prepare, started_client, why_ended
from bench.peers.telling import Listener

from upwash.emulation.enclosure import settle_in

_READY_S = 150.0
_SHIFT_S = 0.7  # shift of the fault from round to round, within the period of the calls
_STRAY_S = 60.0  # that the calls may take beyond what each of them needs at most by its peer's time-outs


class Fault(msgspec.Struct, frozen=True):
    """When it was, and when a server that was killed was ready again."""

    from_s: float
    to_s: float
    ready_s: float


def run(order: Order) -> Figures:
    """Makes the calls with their fault."""
    seen = order.folder / "seen"
    seen.mkdir()
    listener = Listener(seen)
    prepare(order)
    make_link()
    server = Server(order)
    server.start()
    with started_client(order) as client:
        _wait(lambda: listener.began.is_set() or client.poll() is not None, _READY_S)
        if not listener.began.is_set():
            raise RuntimeError(f"the calls did not begin: {why_ended(order)}")
        fault = _make(order, server, seen)
        if client.wait(_longest_s(order)) != 0:
            raise RuntimeError(f"the drone's program failed: {why_ended(order)}")
    return figures_of(listener.told, fault)


def _longest_s(order: Order) -> float:
    return _STRAY_S + order.calls * (PERIOD_S + order.local_s + 5.0)


def _wait(true: Callable[[], bool], within_s: float) -> None:
    give_up_s = time.monotonic() + within_s
    while not true() and time.monotonic() < give_up_s:
        time.sleep(0.02)


def _make(order: Order, server: Server, seen: Path) -> Fault:
    """Waits for the middle of the calls, and makes what goes wrong."""
    middle_s = max(0.0, (order.calls * PERIOD_S - order.fault_s) / 2)
    time.sleep(middle_s + order.round * _SHIFT_S % PERIOD_S)
    from_s = time.monotonic()
    match order.scenario:
        case "none":
            return Fault(from_s, from_s, from_s)
        case "black-out":
            with dark():
                time.sleep(order.fault_s)
        case "killed":
            server.kill()
            time.sleep(order.fault_s)
        case "stopped":
            server.signal(signal.SIGSTOP)
            time.sleep(order.fault_s)
            server.signal(signal.SIGCONT)
        case "late":
            (seen / LATE_FILE).touch()
            time.sleep(order.fault_s)
            (seen / LATE_FILE).unlink()
    to_s = time.monotonic()
    if order.scenario == "killed":
        server.start()
    return Fault(from_s, to_s, time.monotonic())


def figures_of(told: Sequence[Mapping[str, Any]], fault: Fault) -> Figures:
    """The results of the calls, without those before the first that counts."""
    began_s = next(each["at_s"] for each in told if each["what"] == "began")
    calls = [each for each in told if each["what"] == "call"]
    computed = [each["place"] for each in told if each["what"] == "computed" and each["at_s"] >= began_s]
    remote = [call for call in calls if call["place"] == "server"]
    struck = fault.to_s > fault.from_s
    undisturbed_s = [
        call["at_s"] - call["began_s"] for call in remote if not struck or call["at_s"] <= fault.from_s
    ]
    back_s = next((call["at_s"] for call in remote if struck and call["at_s"] >= fault.to_s), None)
    return Figures(
        total_s=calls[-1]["at_s"] - calls[0]["began_s"],
        longest_s=max(call["at_s"] - call["began_s"] for call in calls),
        raised=[call["raised"] for call in calls if call["raised"]],
        by_server=len(remote),
        by_drone=sum(call["place"] == "drone" for call in calls),
        server_computed=computed.count("server"),
        drone_computed=computed.count("drone"),
        remote_s=median(undisturbed_s) if undisturbed_s else None,
        back_s=None if back_s is None else back_s - fault.to_s,
        back_after_ready_s=None if back_s is None else back_s - fault.ready_s,
    )


def main() -> None:
    """Runs the order of that file."""
    settle_in(lambda: os._exit(1))
    order = read_order(Path(sys.argv[1]))
    figures = run(order)
    (order.folder / FIGURES).write_bytes(msgspec.json.encode(figures))


if __name__ == "__main__":
    main()
