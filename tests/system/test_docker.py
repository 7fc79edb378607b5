"""Containers of a real Podman, by Docker's API: what a service in one can do, what is left of it, whom it harms."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.doors import led
from tests.podman import OwnPodman
from tests.system.container_site import DISK_BYTES, MAX_MESSAGE_BYTES, MEMORY_BYTES, PROCESSES, Site
from tests.system.daemons import Guest
from tests.waiting import wait_for

from upwash.cli.main import main
from upwash.errors import EngineError, InstanceError, LinkError, Refused, ServiceError, UsageError
from upwash.real.credentials import Credentials, fingerprint
from upwash.real.docker.container import ContainerSettings
from upwash.real.docker.engine import DockerEngine
from upwash.real.docker.runtime import ContainerRuntime
from upwash.real.link import GrpcDialer
from upwash.real.runtime import sockets_in
from upwash.real.service_image import reference_of

pytestmark = [pytest.mark.root, pytest.mark.system, pytest.mark.xdist_group("podman")]

SERVICES = ("workbench", "vandal")
OpenSite = Callable[..., Any]


@pytest.fixture(scope="module")
def images_held(podman: OwnPodman, docker_images: list[Path]) -> None:
    """Podman holds the images."""
    for image in docker_images:
        podman.command("load", "--input", str(image))


@pytest.fixture
def open_site(
    podman: OwnPodman,
    services: Path,
    credentials: Callable[[str], Credentials],
    images_held: None,
    tmp_path: Path,
) -> OpenSite:
    @asynccontextmanager
    async def site(
        *, freezes: bool = False, devices: Sequence[str] = (), images: dict[str, str] | None = None
    ) -> AsyncIterator[Site]:
        engine = DockerEngine(f"unix://{podman.socket}")
        async with led(credentials("s1")) as lead:
            runtime = ContainerRuntime(
                engine,
                ContainerSettings(
                    tmp_path,
                    memory_bytes=MEMORY_BYTES,
                    processes=PROCESSES,
                    disk_bytes=DISK_BYTES,
                    devices=devices,
                ),
                images or {service: reference_of(service) for service in SERVICES},
                listen=sockets_in(tmp_path),
                freezes=freezes,
                lead=lead,
                max_message_bytes=MAX_MESSAGE_BYTES,
            )
            try:
                await engine.connect()
                await runtime.prepare(["s1", "s2"], list(images or SERVICES))
                heron = credentials("heron")
                dialer = GrpcDialer("heron", heron, max_message_bytes=MAX_MESSAGE_BYTES)
                yield Site(runtime, dialer, services, frozenset({fingerprint(heron.certificate)}))
            finally:
                await runtime.close()

    return site


def at(open_site: OpenSite, use: Callable[[Site], Awaitable[None]], **settings: Any) -> None:
    async def run() -> None:
        async with open_site(**settings) as site:
            await use(site)

    asyncio.run(run())


# --- what a service can do ----------------------------------------------------------------------------------


def test_a_service_has_no_rights_and_reaches_nobody(open_site: OpenSite) -> None:
    async def use(site: Site) -> None:
        vandal = await site.start("s1", "vandal")
        assert await site.call(vandal, "s1", "identity") == [1000, 0]
        for host in ("127.0.0.1", "169.254.0.1", "10.88.0.1"):
            assert await site.call(vandal, "s1", "reach", host, 22) != "connected"
        await vandal.stop()

    at(open_site, use)


@pytest.mark.parametrize("harm", ["eat_memory", "fork_without_end", "fill_disk"])
def test_an_instance_out_of_control_harms_neither_its_neighbours_nor_the_daemon(
    open_site: OpenSite, harm: str
) -> None:
    async def use(site: Site) -> None:
        vandal, neighbour = await site.start("s1", "vandal"), await site.start("s1", "workbench")
        rampage = asyncio.create_task(site.call(vandal, "s1", harm, timeout_s=25.0))
        while not rampage.done():
            assert await site.call(neighbour, "s1", "echo", b"photo") == b"photo"
            await asyncio.sleep(0.1)
        match harm, rampage.exception() or rampage.result():
            case "fork_without_end", int(children):
                assert 0 < children < PROCESSES
            case "fill_disk", int(written_bytes):
                assert written_bytes <= 3 * DISK_BYTES  # /tmp, /var/tmp and /dev/shm
            case _, LinkError() | ServiceError() | MemoryError():
                pass  # it was killed, or it got no more
            case _, outcome:
                pytest.fail(f"{harm} came to {outcome!r}")
        await vandal.stop()
        again = await site.start("s1", "vandal")
        assert (await site.call(again, "s1", "identity"))[0] == 1000
        for instance in (again, neighbour):
            await instance.stop()

    at(open_site, use)


def test_a_device_is_there_where_it_was_given(open_site: OpenSite, podman: OwnPodman) -> None:
    async def use(site: Site) -> None:
        instance = await site.start("s1", "workbench")
        (container,) = podman.running()
        assert "/dev/fuse" in podman.command("exec", container, "ls", "/dev/fuse")
        await instance.stop()

    if not Path("/dev/fuse").exists():
        pytest.skip("no /dev/fuse here")
    at(open_site, use, devices=["/dev/fuse"])


# --- how it ends --------------------------------------------------------------------------------------------


def test_a_service_that_crashes_ends_its_container_with_its_last_words(
    open_site: OpenSite, podman: OwnPodman
) -> None:
    async def use(site: Site) -> None:
        instance = await site.start("s1", "workbench")
        await site.call(instance, "s1", "say", "the lens is broken")
        with pytest.raises(LinkError):
            await site.call(instance, "s1", "crash")
        async with asyncio.timeout(10.0):
            assert await instance.exited() == "ended with code 3: the lens is broken"
        await instance.stop()
        assert podman.there() == []

    at(open_site, use)


def test_a_container_that_is_killed_from_outside_is_noticed_and_started_again(
    open_site: OpenSite, podman: OwnPodman
) -> None:
    async def use(site: Site) -> None:
        instance = await site.start("s1", "workbench")
        (container,) = podman.running()
        os.kill(podman.process_1(container), signal.SIGKILL)
        async with asyncio.timeout(10.0):
            assert "killed by SIGKILL" in await instance.exited()
        await instance.stop()
        again = await site.start("s1", "workbench")
        assert await site.call(again, "s1", "echo", b"photo") == b"photo"
        await again.stop()
        assert podman.there() == []

    at(open_site, use)


def test_a_frozen_instance_thaws_as_it_was_and_forgets_whom_it_admitted(
    open_site: OpenSite, podman: OwnPodman
) -> None:
    async def use(site: Site) -> None:
        first = await site.start("s1", "workbench")
        process = await site.call(first, "s1", "process_id")
        await first.stop()
        assert len(podman.running()) == 1, "it is frozen"
        second = await site.runtime.start(site.spec("s1", "workbench"), called=lambda _: None)
        with pytest.raises(Refused, match="heron has no lease"):
            await site.call(second, "s1", "process_id")
        await second.admit(site.heron)
        assert await site.call(second, "s1", "process_id") == process
        await second.stop()

    at(open_site, use, freezes=True)
    assert podman.there() == []


def test_what_a_killed_daemon_left_ends_by_itself_or_at_the_next_start(
    open_site: OpenSite, podman: OwnPodman, tmp_path: Path, keys: Path, services: Path
) -> None:
    async def use(site: Site) -> None:
        async def visit(server: str, *, leave: bool) -> None:
            guest = Guest(site.dialer, server, address, f"{services}:Workbench")
            endpoint = (await guest.start()).endpoint
            assert await guest.call(endpoint, "echo", b"photo") == b"photo"
            if leave:
                await guest.leave()
            await guest.close()

        with (tmp_path / "stderr").open("w") as stderr:
            process = await asyncio.create_subprocess_exec(
                *serving(tmp_path, podman, keys), stdout=subprocess.PIPE, stderr=stderr
            )
        try:
            assert process.stdout is not None
            address = (await process.stdout.readline()).decode().split()[-1]
            await visit("s2", leave=True)
            paused = ("ps", "--filter", "status=paused", "--quiet")
            await asyncio.to_thread(wait_for, lambda: podman.command(*paused) != "", within_s=10.0)
            await visit("s1", leave=False)
            assert len(podman.running()) == 2
        finally:
            process.kill()
            await process.wait()
        # The one that runs reads the end of its line; the frozen one cannot.
        await asyncio.to_thread(wait_for, lambda: len(podman.running()) == 1, within_s=10.0)

    at(open_site, use)

    async def again(site: Site) -> None:
        assert podman.there() == []
        instance = await site.start("s2", "workbench")
        assert await site.call(instance, "s2", "echo", b"photo") == b"photo"
        await instance.stop()

    at(open_site, again)


def serving(folder: Path, podman: OwnPodman, keys: Path) -> list[str]:
    """The command of a daemon that keeps idle containers frozen, and finds them idle soon."""
    return [
        sys.executable,
        *("-m", "upwash", "serve", "--config"),
        str(configured(folder, podman, keys, 'idle = "freeze"')),
    ]


def configured(folder: Path, podman: OwnPodman, keys: Path, runtime: str = "") -> Path:
    config = folder / "server.toml"
    config.write_text(
        f"""
        listen = "127.0.0.1:0"
        lease_s = 2.0
        idle_stop_s = 0.5
        keys = {{ authority = "{keys}/authority.pem", certificate = "{keys}/s1.pem", key = "{keys}/s1.key" }}
        service = [{{ name = "workbench" }}, {{ name = "vandal" }}]
        server = [{{ name = "s1" }}, {{ name = "s2", images = ["workbench"] }}]
        [runtime]
        kind = "docker"
        memory_bytes = {MEMORY_BYTES}
        engine.addresses = ["unix://{podman.socket}"]
        {runtime}
        """
    )
    return config


def test_a_program_in_cpp_answers_in_a_container_without_certificates(
    podman: OwnPodman, detail: Path, tmp_path: Path, keys: Path
) -> None:
    example = Path(__file__).parents[2] / "examples" / "other-languages"
    shutil.copy(example / "detail.py", tmp_path)
    shutil.copy(detail, tmp_path / "detail")
    config = configured(tmp_path, podman, keys)
    service = '[{ name = "detail", program = "detail.py:Detail", command = ["detail"] }]'
    written = re.sub(r"service = .*", f"service = {service}", config.read_text())
    written = re.sub(r"server = .*", 'server = [{ name = "s1" }]', written)
    config.write_text(re.sub(r"keys = .*", "allow_without_certificates = true", written))
    made = ["package", "detail", "--config", str(config), "--output", str(tmp_path / "images"), "--import"]
    assert main(made) == 0

    async def visit(address: str) -> None:
        dialer = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES)
        guest = Guest(dialer, "s1", address, f"{tmp_path}/detail.py:Detail")
        endpoint = (await guest.start("detail")).endpoint
        assert (await guest.call(endpoint, "measure", bytes(range(256)))).bits_per_byte == 8.0
        await guest.leave()
        await guest.close()

    with subprocess.Popen(
        [sys.executable, "-m", "upwash", "serve", "--config", str(config)], stdout=subprocess.PIPE, text=True
    ) as daemon:
        assert daemon.stdout is not None
        try:
            asyncio.run(visit(daemon.stdout.readline().split()[-1]))
        finally:
            daemon.terminate()
    assert daemon.returncode == 0
    assert podman.there() == []


# --- images -------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("images_held")
def test_an_image_of_a_dockerfile_is_served(open_site: OpenSite, podman: OwnPodman, tmp_path: Path) -> None:
    """Whoever writes one needs upwash for its Python, and two labels."""
    (tmp_path / "Containerfile").write_text(
        'FROM upwash-workbench\nLABEL upwash.service=workbench upwash.methods="" upwash.concurrency=""\n'
        "COPY note.txt /note.txt\n"
    )
    (tmp_path / "note.txt").write_text("made by hand")
    podman.command("build", "--network=none", "--tag", "by-hand", str(tmp_path))

    async def use(site: Site) -> None:
        instance = await site.start("s1", "workbench")
        assert await site.call(instance, "s1", "echo", b"photo") == b"photo"
        (container,) = podman.running()
        assert podman.command("exec", container, "cat", "/note.txt") == "made by hand"
        await instance.stop()

    at(open_site, use, images={"workbench": "by-hand"})


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (
            {"workbench": "localhost/nowhere:latest"},
            "no image localhost/nowhere:latest for workbench: make one with",
        ),
        ({"unpackaged": "upwash-workbench"}, "upwash-workbench is an image of workbench, not of unpackaged"),
    ],
)
def test_a_start_with_a_wrong_image_names_the_remedy(
    open_site: OpenSite, images: dict[str, str], message: str
) -> None:
    async def use(_: Site) -> None:
        pytest.fail("it was prepared")

    with pytest.raises(EngineError, match=message):
        at(open_site, use, images=images)


def test_an_image_whose_program_is_missing_says_so(
    open_site: OpenSite, podman: OwnPodman, tmp_path: Path
) -> None:
    (tmp_path / "Containerfile").write_text(
        "FROM upwash-workbench\nLABEL upwash.service=workbench upwash.program=lost.py:Workbench\n"
    )
    podman.command("build", "--network=none", "--tag", "lost", str(tmp_path))

    async def use(_: Site) -> None:
        pytest.fail("it was prepared")

    with pytest.raises(EngineError, match=r"does not say what lost\.py:Workbench declares: .*lost\.py"):
        at(open_site, use, images={"workbench": "lost"})


def test_without_an_engine_the_daemon_does_not_start_and_says_what_to_do() -> None:
    async def connect() -> None:
        engine = DockerEngine("unix:///nowhere.sock")
        try:
            await engine.connect()
        finally:
            await engine.close()

    with pytest.raises(UsageError, match=r"no engine answers at unix:///nowhere\.sock: is it running"):
        asyncio.run(connect())


def test_what_a_daemon_can_run_is_listed_and_an_image_is_packaged_into_its_engine(
    podman: OwnPodman, tmp_path: Path, keys: Path, services: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = configured(tmp_path, podman, keys)
    written = config.read_text().replace('"vandal"', '"vandal", image = "nowhere:1"', 1)
    config.write_text(written.replace('"workbench"', f'"workbench", program = "{services}:Workbench"', 1))
    made = ["package", "workbench", "--config", str(config), "--output", str(tmp_path / "images"), "--import"]
    assert main(made) == 0
    assert capsys.readouterr().out.strip().endswith(".tar")
    assert main(["images", "--config", str(config)]) == 1
    listed = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "nowhere:1 missing" in listed["vandal"]
    assert "upwash-workbench" in listed["workbench"]


def test_a_daemon_that_cannot_start_an_instance_leaves_no_container(
    open_site: OpenSite, podman: OwnPodman, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def use(site: Site) -> None:
        monkeypatch.setattr("upwash.real.docker.container.COMMAND", ("/bin/false",))
        with pytest.raises(InstanceError, match="did not start"):
            await site.start("s1", "workbench")
        assert podman.there() == []

    at(open_site, use)
