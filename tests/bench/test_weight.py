"""What the drone's programs must not hold in memory, and the measurement that says what they do hold."""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from bench.weight import CALLS, PROGRAMS, ROOT, Weight, flying, module_weights, summary, weigh

from upwash.real.trust.authority import make_keys

# Packages that a flight, or a service's process, loads only where its configuration or its user asks for them.
ASKED_FOR = {
    *("cryptography", "cv2", "dbus_fast", "distributed", "matplotlib", "numpy", "onnx", "onnxruntime"),
    *("packaging", "prometheus_client", "pyarrow", "pylxd", "rich", "starlette", "uvicorn"),
    *("http.server", "importlib.metadata", "multiprocessing", "unittest"),
}
# Parts of upwash that are other programs', or are for what is asked for at the end.
OTHERS = {
    "upwash fly": (
        *("upwash.eventlog.terminal", "upwash.lab", "upwash.packaging", "upwash.server"),
        *("upwash.vehicle", "upwash.view"),
    ),
    "its service": (
        *("upwash.cli", "upwash.config", "upwash.drone", "upwash.eventlog", "upwash.launch"),
        *("upwash.plans", "upwash.ports", "upwash.real.mavlink", "upwash.real.instances.sandbox"),
        *("upwash.sim", "upwash.vehicle", "pymavlink", "ctypes"),
    ),
}

on_linux = pytest.mark.skipif(not Path("/proc/self/smaps").exists(), reason="/proc/PID/smaps is Linux's")


@pytest.mark.long
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_imports_nothing_that_it_may_not_need(program: str) -> None:
    imported = module_weights(PROGRAMS[program], ROOT)
    assert set(PROGRAMS[program].split()) <= set(imported)
    needless = ASKED_FOR.union(OTHERS[program])
    assert not {
        name for name in imported if any(name == each or name.startswith(f"{each}.") for each in needless)
    }


@pytest.fixture
def idle() -> Iterator[int]:
    """The process of an interpreter that waits."""
    code = "import sys; print(flush=True); sys.stdin.read()"
    with subprocess.Popen(
        (sys.executable, "-c", code), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process.pid


@on_linux
def test_pages_of_files_count_once_for_processes_together_and_their_own_for_each(idle: int) -> None:
    one, twice = weigh(idle), weigh(idle, idle)
    assert 0.0 < one.own_mb < one.proportional_mb <= one.alone_mb
    assert twice.own_mb == pytest.approx(2 * one.own_mb)
    assert twice.alone_mb - twice.own_mb == pytest.approx(one.alone_mb - one.own_mb)


@on_linux
def test_all_mappings_of_a_process_are_weighed() -> None:
    here = os.getpid()
    with mmap.mmap(
        -1, 50_000_000, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
    ) as block:  # none that was freed
        before = weigh(here)
        block.write(b"x" * len(block))
        grown_mb = weigh(here).own_mb - before.own_mb
        assert len(block) / 1e6 == pytest.approx(grown_mb, rel=0.1)


def test_a_summary_has_medians_and_the_rounds_own_ratios() -> None:
    def found(drone_mb: float, grpc_mb: float) -> dict[str, Weight]:
        each = {"gRPC client": grpc_mb, "HTTP client": 2.0, "drone": drone_mb}
        return {what: Weight(alone_mb, alone_mb, alone_mb) for what, alone_mb in each.items()}

    drone = summary([found(10.0, 5.0), found(30.0, 10.0), found(20.0, 20.0)])[-1]
    assert (drone.what, drone.weight) == ("drone", Weight(20.0, 20.0, 20.0))
    assert (drone.ratio_to_grpc, drone.ratio_to_http) == (2.0, 10.0)


@on_linux
@pytest.mark.system
@pytest.mark.nightly
@pytest.mark.parametrize("with_server", [False, True])
def test_a_drone_is_weighed_while_it_flies(tmp_path: Path, with_server: bool) -> None:
    make_keys(tmp_path, servers=[["s1"]], drones=["drone"])
    with flying(tmp_path, ROOT, with_server=with_server) as (program, service):
        together = weigh(program, service)
        assert max(weigh(program).own_mb, weigh(service).own_mb) < together.own_mb < together.alone_mb
    events = (tmp_path / "events.jsonl").read_text()
    assert events.count('"event":"call"') >= CALLS
    assert '"event":"mission_ended"' not in events
