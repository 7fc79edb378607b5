"""The manifests of deploy/: a daemon runs as process 1, as they start it, and answers the probes that they have."""

from __future__ import annotations

import http.client
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.children import children, processes
from tests.waiting import wait_for

from upwash.config.daemon import DaemonConfig, read_daemon_config
from upwash.launch.daemon import _ENDING_S
from upwash.real.trust.authority import make_keys

pytestmark = pytest.mark.system

DEPLOY = Path(__file__).parents[2] / "deploy"
NODE = "field-1.example"
POD = yaml.safe_load((DEPLOY / "kubernetes/server/daemonset.yaml").read_text())["spec"]["template"]["spec"]
CONTAINER = POD["containers"][0]
PROBES = [CONTAINER[name]["httpGet"] for name in ("startupProbe", "livenessProbe", "readinessProbe")]
COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]["upwash"]
FIRST = ["unshare", "--user", "--map-root-user", "--pid", "--mount-proc", "--fork", "--kill-child"]


@dataclass(frozen=True)
class Pod:
    """A folder that stands in for the file system of the pod."""

    folder: Path

    def command(self, command: list[str], **texts: str) -> list[str]:
        """The command of a container of the pod, with its paths in the folder."""
        words = [re.sub(r"/(config|keys|run/upwash)/", rf"{self.folder}/\1/", word) for word in command]
        for old, new in {"$(NODE_NAME)": NODE, **texts}.items():
            words = [word.replace(old, new) for word in words]
        return words

    @property
    def configuration(self) -> Path:
        return self.folder / "run/upwash/server.toml"


@pytest.fixture
def pod(tmp_path: Path) -> Pod:
    """A pod whose first container has written the configuration."""
    pod = Pod(tmp_path)
    make_keys(tmp_path / "keys", servers=[[NODE]], drones=["d1"])
    (tmp_path / "run/upwash").mkdir(parents=True)
    (tmp_path / "config").mkdir()
    text = (DEPLOY / "kubernetes/server/server.toml").read_text().replace("/keys/", f"{tmp_path}/keys/")
    (tmp_path / "config/server.toml").write_text(text)
    subprocess.run(pod.command(POD["initContainers"][0]["command"]), check=True)
    return pod


def longest_end_s(config: DaemonConfig) -> float:
    return config.drain_s + _ENDING_S


def test_manifests_and_the_configuration_agree(pod: Pod) -> None:
    config = read_daemon_config(pod.configuration)
    assert [server.name for server in config.identities] == [NODE]
    assert {f"{probe['host']}:{probe['port']}" for probe in PROBES} == {config.metrics}
    assert f"http://{config.metrics}/ready" in COMPOSE["healthcheck"]["test"][-1]
    (port,) = CONTAINER["ports"]
    assert config.listen == f"*:{port['hostPort']}" == f"*:{port['containerPort']}"
    assert POD["terminationGracePeriodSeconds"] > longest_end_s(config)
    assert int(COMPOSE["stop_grace_period"].removesuffix("s")) > longest_end_s(config)
    mounted = {
        mount["name"] for each in (*POD["initContainers"], CONTAINER) for mount in each["volumeMounts"]
    }
    assert mounted == {volume["name"] for volume in POD["volumes"]}


@pytest.mark.parametrize("variant", ["server", "gpu"])
def test_kustomizations_name_what_is_there(variant: str) -> None:
    folder = DEPLOY / "kubernetes" / variant
    kustomization = yaml.safe_load((folder / "kustomization.yaml").read_text())
    generated = kustomization.get("configMapGenerator", [])
    files = [file for each in generated for file in each["files"]]
    assert all((folder / file).exists() for file in (*kustomization["resources"], *files))
    (volume,) = (volume["configMap"]["name"] for volume in POD["volumes"] if "configMap" in volume)
    assert {each["name"] for each in generated} <= {volume}
    for patch in kustomization.get("patches", []):
        spec = yaml.safe_load(patch["patch"])["spec"]["template"]["spec"]
        assert [container["name"] for container in spec["containers"]] == [CONTAINER["name"]]


@contextmanager
def started(pod: Pod) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The daemon's container without its image, and the address of its probes."""
    text = pod.configuration.read_text()
    for old, new in (("*:7070", "127.0.0.1:0"), ("instance_ports = [7100, 7119]", ""), (":7071", ":0")):
        text = text.replace(old, new)
    pod.configuration.write_text(text)
    command = pod.command(CONTAINER["command"])
    assert command[0] == "upwash"
    log = pod.folder / "log"
    with (
        log.open("w") as stderr,
        subprocess.Popen(
            [*FIRST, sys.executable, "-m", *command],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        ) as outside,
    ):
        try:
            assert outside.stdout is not None
            said = outside.stdout.readline()
            if log.read_text().startswith("unshare: "):
                pytest.skip(f"no process 1 can be made here: {log.read_text()}")
            assert said.startswith(f"{NODE} ready at"), log.read_text()
            (address,) = re.findall(r"metrics at http://(\S+)/metrics", log.read_text())
            yield outside, address
        finally:
            outside.kill()


def test_as_process_1_it_answers_the_probes_reaps_orphans_and_ends_at_sigterm(pod: Pod) -> None:
    with started(pod) as (outside, address):
        (first,) = children(outside.pid)
        for probe in PROBES:
            connection = http.client.HTTPConnection(address, timeout=10.0)
            connection.request("GET", probe["path"])
            assert connection.getresponse().status == 200
        probed = COMPOSE["healthcheck"]["test"]
        assert probed[:2] == ["CMD", "python3"]
        asked = [word.replace("127.0.0.1:7071", address) for word in probed[2:]]
        subprocess.run([sys.executable, *asked], check=True)

        inside = ["nsenter", "--target", str(first), "--user", "--pid", "--preserve-credentials"]
        subprocess.run(
            [*inside, "sh", "-c", "sh -c 'exit 3' &"], check=True
        )  # an orphan, once its parent has ended
        wait_for(lambda: [each.state for each in of(first)] == ["S"], seen=lambda: of(first))
        subprocess.run([*inside, "sh", "-c", "kill -TERM 1"], check=True)
        assert outside.wait(timeout=20.0) == 0


def of(parent: int) -> list[Any]:
    """The children of that process, also those that nobody has reaped."""
    return [each for each in processes() if each.parent == parent]
