"""Containers of a real Podman, by Docker's API: what differs from those of other engines (test_containers.py)."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import pytest
from tests.podman import OwnPodman
from tests.programs import ROOT, running
from tests.system.container_site import Host
from tests.system.daemons import MAX_MESSAGE_BYTES, Guest

from upwash.cli.main import main
from upwash.errors import EngineError, InstanceError, UsageError
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.link.link import GrpcDialer

pytestmark = [pytest.mark.root, pytest.mark.system, pytest.mark.xdist_group("podman")]

# --- what a service can do ----------------------------------------------------------------------------------


async def test_a_service_has_no_rights_and_reaches_nobody(docker_host: Host) -> None:
    async with docker_host.open_site() as site:
        vandal = await site.start("s1", "vandal")
        assert await site.call(vandal, "s1", "identity") == [1000, 0]
        for host in ("127.0.0.1", "169.254.0.1", "10.88.0.1"):
            assert await site.call(vandal, "s1", "reach", host, 22) != "connected"
        await vandal.stop()


async def test_a_device_is_there_where_it_was_given(docker_host: Host, podman: OwnPodman) -> None:
    if not Path("/dev/fuse").exists():
        pytest.skip("no /dev/fuse here")
    async with docker_host.open_site(devices=["/dev/fuse"]) as site:
        instance = await site.start("s1", "workbench")
        (container,) = podman.running()
        assert "/dev/fuse" in podman.command("exec", container, "ls", "/dev/fuse")
        await instance.stop()


def test_a_program_in_cpp_answers_in_a_container_without_certificates(
    docker_host: Host, podman: OwnPodman, detail: Path, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "examples" / "other-languages" / "detail.py", tmp_path)
    shutil.copy(detail, tmp_path / "detail")
    service = {"name": "detail", "program": "detail.py:Detail", "command": ["detail"]}
    config = docker_host.configured(tmp_path, None, service=[service], server=[{"name": "s1"}])
    made = ["package", "detail", "--config", str(config), "--output", str(tmp_path / "images"), "--import"]
    assert main(made) == 0

    async def visit(address: str) -> None:
        dialer = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES)
        guest = Guest(dialer, "s1", address, f"{tmp_path}/detail.py:Detail")
        endpoint = (await guest.start("detail")).endpoint
        assert (await guest.call(endpoint, "measure", bytes(range(256)))).bits_per_byte == 8.0
        await guest.leave()
        await guest.close()

    with running("serve", "--config", config, stderr=None) as daemon:
        assert daemon.stdout is not None
        asyncio.run(visit(daemon.stdout.readline().split()[-1]))
        daemon.terminate()
        assert daemon.wait(30.0) == 0
    assert podman.there() == []


# --- images -------------------------------------------------------------------------------------------------


async def test_an_image_of_a_dockerfile_is_served(
    docker_host: Host, podman: OwnPodman, tmp_path: Path
) -> None:
    """Whoever writes one needs upwash for its Python, and two labels."""
    (tmp_path / "Containerfile").write_text(
        'FROM upwash-workbench\nLABEL upwash.service=workbench upwash.methods="" upwash.concurrency=""\n'
        "COPY note.txt /note.txt\n"
    )
    (tmp_path / "note.txt").write_text("made by hand")
    podman.command("build", "--network=none", "--tag", "by-hand", str(tmp_path))

    async with docker_host.open_site(images={"workbench": "by-hand"}) as site:
        instance = await site.start("s1", "workbench")
        assert await site.call(instance, "s1", "echo", b"photo") == b"photo"
        (container,) = podman.running()
        assert podman.command("exec", container, "cat", "/note.txt") == "made by hand"
        await instance.stop()


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
async def test_a_start_with_a_wrong_image_names_the_remedy(
    docker_host: Host, images: dict[str, str], message: str
) -> None:
    with pytest.raises(EngineError, match=message):
        async with docker_host.open_site(images=images):
            pytest.fail("it was prepared")


async def test_an_image_whose_program_is_missing_says_so(
    docker_host: Host, podman: OwnPodman, tmp_path: Path
) -> None:
    (tmp_path / "Containerfile").write_text(
        "FROM upwash-workbench\nLABEL upwash.service=workbench upwash.program=lost.py:Workbench\n"
    )
    podman.command("build", "--network=none", "--tag", "lost", str(tmp_path))

    with pytest.raises(EngineError, match=r"does not say what lost\.py:Workbench declares: .*lost\.py"):
        async with docker_host.open_site(images={"workbench": "lost"}):
            pytest.fail("it was prepared")


async def test_without_an_engine_the_daemon_does_not_start_and_says_what_to_do() -> None:
    engine = DockerEngine("unix:///nowhere.sock")
    with pytest.raises(UsageError, match=r"no engine answers at unix:///nowhere\.sock: is it running"):
        await engine.connect()
    await engine.close()


def test_what_a_daemon_can_run_is_listed_and_an_image_is_packaged_into_its_engine(
    docker_host: Host, tmp_path: Path, keys: Path, services: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    workbench = {"name": "workbench", "program": f"{services}:Workbench"}
    vandal = {"name": "vandal", "image": "nowhere:1"}
    config = docker_host.configured(tmp_path, keys, service=[workbench, vandal])
    made = ["package", "workbench", "--config", str(config), "--output", str(tmp_path / "images"), "--import"]
    assert main(made) == 0
    assert capsys.readouterr().out.strip().endswith(".tar")
    assert main(["images", "--config", str(config)]) == 1
    listed = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "nowhere:1 missing" in listed["vandal"]
    assert "upwash-workbench" in listed["workbench"]


async def test_a_daemon_that_cannot_start_an_instance_leaves_no_container(
    docker_host: Host, podman: OwnPodman, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with docker_host.open_site() as site:
        monkeypatch.setattr("upwash.real.instances.docker.container.COMMAND", ("/bin/false",))
        with pytest.raises(InstanceError, match="did not start"):
            await site.start("s1", "workbench")
        assert podman.there() == []
