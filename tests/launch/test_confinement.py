"""The limits of each service: its own, else the daemon's, else the default; one that would not hold is refused."""

from __future__ import annotations

import json
import os
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingUnixStreamServer
from threading import Thread

import pytest
from msgspec.structs import replace

from upwash.config.daemon import DaemonConfig, read_daemon_config
from upwash.core.admission.limits import DEFAULT_LIMITS, NO_LIMITS, Limits
from upwash.errors import UsageError
from upwash.launch.confinement import Confinement, find_confinement
from upwash.launch.daemon_services import DaemonServices
from upwash.real.instances.sandbox import Sandbox

CONFIG = """
listen = "unix:daemon.sock"
allow_without_certificates = true
[runtime]
sandbox = "off"
{runtime}
[[service]]
name = "counter"
{service}
[[service]]
name = "detector"
[[server]]
name = "s1"
"""
EVERY = {"memory_bytes": 2**28, "processes": 64, "disk_bytes": 2**22, "cpus": 1}


def read(folder: Path, *, runtime: str = "", service: str = "") -> DaemonConfig:
    file = folder / "server.toml"
    file.write_text(CONFIG.format(runtime=runtime, service=service))
    return read_daemon_config(file)


def test_a_service_has_its_own_limits_over_the_daemons_over_the_defaults(tmp_path: Path) -> None:
    config = read(
        tmp_path,
        runtime="memory_bytes = 536_870_912\nprocesses = 128",
        service="memory_bytes = 268_435_456\ncpus = 1",
    )
    files = DEFAULT_LIMITS.disk_bytes
    assert Confinement().limits(config) == {
        "counter": Limits(memory_bytes=2**28, processes=128, disk_bytes=files, cpus=1),
        "detector": Limits(memory_bytes=2**29, processes=128, disk_bytes=files),
    }


@pytest.mark.parametrize("devices", ['"nvidia.com/gpu=0"', '"/dev/nvidia0"', '"/dev/dri"'])
def test_a_service_with_a_card_may_use_the_memory_that_cuda_reserves(tmp_path: Path, devices: str) -> None:
    limits = Confinement().limits(read(tmp_path, service=f"devices = [{devices}]"))
    assert limits["counter"].memory_bytes == (2**32 if "nvidia" in devices else DEFAULT_LIMITS.memory_bytes)
    assert limits["detector"] == DEFAULT_LIMITS
    smaller = read(tmp_path, runtime="memory_bytes = 536_870_912", service=f"devices = [{devices}]")
    assert Confinement().limits(smaller)["counter"].memory_bytes == 2**29


@pytest.mark.parametrize(("table", "named"), [("service", 'service "counter"'), ("runtime", r"\[runtime\]")])
@pytest.mark.parametrize("name", EVERY)
def test_a_limit_that_would_not_hold_is_refused_by_name_and_a_default_is_left_out(
    tmp_path: Path, table: str, named: str, name: str
) -> None:
    without = Confinement(unenforced={name: "this kernel knows none: take another"})
    config = read(tmp_path, **{table: f"{name} = {EVERY[name]}"})
    why = (
        f"^{name} of {named} would have no effect: this kernel knows none: take another; or leave {name} out$"
    )
    with pytest.raises(UsageError, match=why):
        without.limits(config)
    assert getattr(without.limits(read(tmp_path))["counter"], name) is None


@pytest.mark.parametrize("name", EVERY)
async def test_without_a_sandbox_no_limit_holds_and_none_is_ignored_in_silence(
    tmp_path: Path, name: str
) -> None:
    found = await find_confinement(read(tmp_path))
    assert set(found.limits(read(tmp_path)).values()) == {NO_LIMITS}
    with pytest.raises(UsageError, match=f'{name} of service .*runtime.sandbox is "off": say "required"'):
        found.limits(read(tmp_path, service=f"{name} = {EVERY[name]}"))


def test_more_processors_than_there_are_are_no_limit(tmp_path: Path) -> None:
    there = len(os.sched_getaffinity(0))
    in_sandbox = Confinement(Sandbox("bwrap"))
    assert in_sandbox.limits(read(tmp_path, service=f"cpus = {there}"))["counter"].cpus == there
    with pytest.raises(UsageError, match=f"cpus = {there + 1} of service .* the daemon may use {there}"):
        in_sandbox.limits(read(tmp_path, service=f"cpus = {there + 1}"))


def test_a_device_that_is_not_here_ends_the_start_instead_of_the_sandbox(tmp_path: Path) -> None:
    config = read(tmp_path, runtime='devices = ["/dev/null", "/dev/nosuchcard0"]')
    runtime = replace(config.runtime, sandbox="auto", sandbox_as_root=True)
    config = replace(config, runtime=runtime)
    with pytest.raises(UsageError, match="devices: /dev/nosuchcard0 cannot be seen here: load the driver"):
        Confinement(Sandbox("bwrap")).devices(config)


def test_a_service_has_its_own_devices_or_those_of_all_others(tmp_path: Path) -> None:
    config = read(tmp_path, runtime='devices = ["/dev/null"]', service="devices = []")
    assert Confinement(Sandbox("bwrap")).devices(config) == {"counter": (), "detector": ("/dev/null",)}
    config = read(tmp_path, service='devices = ["/dev/null", "/dev/zero", "/dev/null"]')
    assert Confinement(Sandbox("bwrap")).devices(config) == {
        "counter": ("/dev/null", "/dev/zero"),
        "detector": (),
    }


class Engine(BaseHTTPRequestHandler):
    """A container engine on a machine without the control group for memory."""

    def do_GET(self) -> None:
        says = {
            "ApiVersion": "1.41",
            "MinAPIVersion": "1.12",
            "Version": "1",
            "MemoryLimit": False,
            "PidsLimit": True,
        }
        body = json.dumps(says).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Type", "application/json")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None: ...


async def test_a_limit_that_docker_cannot_put_on_containers_is_refused(tmp_path: Path) -> None:
    at = f"unix://{tmp_path}/engine.sock"
    docker = f'kind = "docker"\nengine.addresses = ["{at}"]'
    with ThreadingUnixStreamServer(f"{tmp_path}/engine.sock", Engine) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        found = await find_confinement(read(tmp_path, runtime=docker))
        server.shutdown()
    allowed = read(tmp_path, runtime=docker, service="processes = 64")
    assert found.limits(allowed)["counter"] == Limits(processes=64, disk_bytes=DEFAULT_LIMITS.disk_bytes)
    with pytest.raises(
        UsageError, match=f"memory_bytes of service .* the engine at {at} has no control group"
    ):
        found.limits(read(tmp_path, runtime=docker, service="memory_bytes = 268_435_456"))


async def test_a_reload_with_a_limit_that_would_not_hold_is_refused(tmp_path: Path) -> None:
    config = read(tmp_path)
    config = replace(config, images=config.images[1:])  # the bundled detector
    confinement = Confinement(unenforced={"cpus": "there is no taskset"})
    services = await DaemonServices.found(config, confinement)
    limited = replace(config, images=(replace(config.images[0], cpus=1),))
    with pytest.raises(
        UsageError, match='cpus of service "detector" would have no effect: there is no taskset'
    ):
        await services.anew(limited)
    assert services.images["detector"].limits == DEFAULT_LIMITS
