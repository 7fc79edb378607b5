"""The edge daemon's configuration: what a file means, and what is refused."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from upwash.config.daemon import DaemonConfig, ImageConfig, PeerConfig, read_daemon_config
from upwash.config.drone_file import read_drone_config
from upwash.core.admission.limits import DEFAULT_LIMITS
from upwash.errors import ConfigError

EXAMPLES = Path(__file__).parents[2] / "examples"
FULL = (Path(__file__).parent / "daemon.toml").read_text()
KEYS = FULL[FULL.index("[keys]") : FULL.index("[[service]]")]
REST = FULL[FULL.index("[[service]]") :]


def read(tmp_path: Path, text: str) -> DaemonConfig:
    file = tmp_path / "server.toml"
    file.write_text(text)
    return read_daemon_config(file)


def test_every_printed_value_is_read(tmp_path: Path) -> None:
    config = read(tmp_path, FULL)
    assert config.images == (
        ImageConfig(name="detector", program="upwash.services:Detector"),
        ImageConfig(name="counter"),
    )
    assert [identity.images for identity in config.identities] == [("detector",), ("detector", "counter")]
    assert config.keys is not None
    assert config.keys.key == tmp_path / "keys/s1.key"


def test_a_list_of_revoked_certificates_beside_the_authority_is_meant_without_being_named(
    tmp_path: Path,
) -> None:
    assert _revoked(tmp_path, KEYS) == tmp_path / "keys/revoked.txt"
    assert _revoked(tmp_path, f'{KEYS}revoked = "mine.txt"\n') == tmp_path / "mine.txt"


def _revoked(tmp_path: Path, keys: str) -> Path | None:
    config = read(tmp_path, keys + REST)
    assert config.keys is not None
    return config.keys.list_of_revoked


def test_what_a_file_leaves_out_has_the_printed_defaults(tmp_path: Path) -> None:
    brief, full = read(tmp_path, KEYS + REST), read(tmp_path, FULL)
    assert brief.runtime.engine_addresses == full.runtime.engine_addresses
    engine = replace(full.runtime.engine, addresses=None)
    limits = {"memory_bytes": DEFAULT_LIMITS.memory_bytes, "processes": DEFAULT_LIMITS.processes}
    assert replace(brief, runtime=replace(brief.runtime, **limits)) == replace(
        full, runtime=replace(full.runtime, engine=engine)
    )


@pytest.mark.parametrize("address", ["127.0.0.1:0", "[::1]:7070", "localhost:7070", "unix:/run/upwash.sock"])
def test_without_certificates_it_may_listen_where_only_this_machine_can_call(
    tmp_path: Path, address: str
) -> None:
    config = read(tmp_path, f'listen = "{address}"\nallow_without_certificates = true\n{REST}')
    assert (config.listen, config.keys) == (address, None)


@pytest.mark.parametrize(
    "address", ["0.0.0.0:7070", "[::]:7070", "*:7070", ":7070", "10.0.0.1:7070", "edge.example:7070"]
)
def test_without_certificates_it_may_not_listen_to_others(tmp_path: Path, address: str) -> None:
    with pytest.raises(ConfigError, match=r"127\.0\.0\.1:7070") as refusal:
        read(tmp_path, f'listen = "{address}"\nallow_without_certificates = true\n{REST}')
    assert refusal.value.key == "allow_without_certificates"


@pytest.mark.parametrize(
    ("old", "new", "key", "named"),
    [
        (KEYS, "", "keys", "allow_without_certificates = true on a loopback"),
        ("certificates = false", "certificates = true", "allow_without_certificates", "remove one"),
        ('key = "keys/s1.key"', "", "keys.key", "missing: add a file's path"),
        ("0.0.0.0:7070", "7070", "listen", "host:port"),
        ("lease_s = 30.0", "instance_ports = [7100]", "instance_ports", "[7100, 7119]"),
        ("lease_s = 30.0", "instance_ports = [7103, 7102]", "instance_ports", "give the first and the last"),
        ("lease_s = 30.0", "instance_ports = [7100, 7101]", "instance_ports", "3 instances, one of each"),
        ("lease_s = 30.0", "instance_ports = [7070, 7079]", "instance_ports", "the daemon's own port"),
        ("lease_s = 30.0", 'metrics = "9100"', "metrics", '"127.0.0.1:9100"'),
        ("lease_s = 30.0", 'metrics = "unix:here"', "metrics", "host:port"),
        ("lease_s = 30.0", 'metrics_hosts = ["edge"]', "metrics_hosts", "needs metrics"),
        (
            "lease_s = 30.0",
            'metrics = ":9100"\nmetrics_hosts = ["a:1"]',
            "metrics_hosts[0]",
            "without a port",
        ),
        ("lease_s = 30.0", "outside_ports = [17100, 17102]", "outside_ports", "needs instance_ports"),
        (
            "lease_s = 30.0",
            "instance_ports = [7100, 7102]\noutside_ports = [17100, 17101]",
            "outside_ports",
            "expected 3 ports",
        ),
        ("0.0.0.0:7070", "unix:", "listen", "unix:path"),
        ("16_777_216", "0", "max_message_bytes", "from 1024 to 2147483647"),
        ("lease_s = 30.0", "lease_s = 1.9", "lease_s", "at least 2"),
        ("idle_stop_s", "idle_s", "idle_s", 'did you mean "idle_stop_s"?'),
        ('images = ["detector"]', 'images = ["detecter"]', "server[0].images", 'did you mean "detector"?'),
        ('images = ["detector"]', "images = [1]", "server[0].images[0]", "a string, found 1"),
        ("slots = 1", "slots = 0.5", "server[0].slots", "an integer of at least 1"),
        ("slots = 1", "slots = 0", "server[0].slots", 'at least 1, or "auto", found 0'),
        ("slots = 1", 'slots = "many"', "server[0].slots", 'at least 1, or "auto", found "many"'),
        ("slots = 1", "turn_s = 4.9", "server[0].turn_s", "at least 5, in seconds, or inf for turns"),
        ("slots = 1", "turn_s = nan", "server[0].turn_s", "a finite number"),
        ("lease_s = 30.0", "lease_s = inf", "lease_s", "a finite number"),
        ('name = "s2"', 'name = "s1"', "server[1].name", 'a second server named "s1"'),
        ('name = "s2"', 'name = "local"', "server[1].name", "stands for the drone itself in results"),
        ('name = "counter"', 'name = "detector"', "service[1].name", 'a second service named "detector"'),
        ('name = "counter"', 'name = "count er"', "service[1].name", "letters, digits"),
        ('kind = "process"', 'kind = "podman"', "runtime.kind", 'one of "docker", "lxd", "process"'),
        ("memory_bytes = 2_147_483_648", "memory_bytes = 2_147", "runtime.memory_bytes", "64 MiB"),
        ('name = "counter"', 'name = "counter"\nmemory_bytes = 5', "service[1].memory_bytes", "64 MiB"),
        ('name = "counter"', 'name = "counter"\ncpus = 0', "service[1].cpus", "from 1 to 4096"),
        ('name = "counter"', 'name = "counter"\nmemory = 5', "service[1].memory", "memory_bytes"),
        ("unix:/var/lib", "ssh:/var/lib", "runtime.engine.addresses[0]", "https://host:port"),
        ("unix:/var/lib", "https://10.0.0.2", "runtime.engine.certificate", "missing"),
        ("10.147.70.0/24", "10.147.70.1/24", "runtime.network.subnet", "host bits set"),
        ("10.147.70.0/24", "10.147.70.0/31", "runtime.network.subnet", "from /16 to /30"),
        (REST, "", "service", "[[service]], at least one"),
        (REST, '[[service]]\nname = "detector"\n', "server", "[[server]], at least one"),
    ],
)
def test_a_refusal_names_the_key_and_the_remedy(
    tmp_path: Path, old: str, new: str, key: str, named: str
) -> None:
    assert old in FULL
    with pytest.raises(ConfigError) as refusal:
        read(tmp_path, FULL.replace(old, new, 1))
    assert refusal.value.key == key
    assert named in refusal.value.problem


def test_ports_for_instances_need_certificates_and_a_network(tmp_path: Path) -> None:
    assert read(tmp_path, "instance_ports = [7100, 7102]\n" + KEYS + REST).instance_ports == (7100, 7102)
    for listen in ("127.0.0.1:7070", "unix:/run/upwash.sock"):
        top = f'instance_ports = [7100, 7102]\nlisten = "{listen}"\nallow_without_certificates = true\n'
        with pytest.raises(ConfigError, match="instance_ports: needs"):
            read(tmp_path, top + REST)


def test_a_turn_may_have_no_end(tmp_path: Path) -> None:
    config = read(tmp_path, FULL.replace("slots = 1", "turn_s = inf", 1))
    assert [(identity.slots, identity.turn_s) for identity in config.identities] == [
        ("auto", math.inf),
        ("auto", 30.0),
    ]


PEER = '[[peer]]\nname = "s3"\naddress = "10.0.0.3:7070"\n'


def test_peers_are_other_daemons_that_certificates_can_be_shown_to(tmp_path: Path) -> None:
    assert read(tmp_path, FULL + PEER).peers == (PeerConfig(name="s3", address="10.0.0.3:7070"),)
    for text, key, named in (
        (FULL + PEER + PEER, "peer[1].name", 'a second peer named "s3"'),
        (FULL + PEER.replace("s3", "s2"), "peer[0].name", "s2 is this daemon itself"),
        (FULL + PEER.replace(":7070", ""), "peer[0].address", "host:port"),
        (FULL.replace("0.0.0.0:7070", "unix:/run/upwash") + PEER, "peer[0].address", "another machine"),
    ):
        with pytest.raises(ConfigError) as refusal:
            read(tmp_path, text)
        assert refusal.value.key == key
        assert named in refusal.value.problem


def test_the_drones_file_and_the_daemons_are_not_mixed_up() -> None:
    with pytest.raises(ConfigError, match="a drone's configuration: name the daemon's file"):
        read_daemon_config(EXAMPLES / "pests.toml")
    with pytest.raises(ConfigError, match="a daemon's configuration: name the drone's file"):
        read_drone_config(EXAMPLES / "pests_server.toml")


def test_containers_need_certificates_and_a_network(tmp_path: Path) -> None:
    text = f'allow_without_certificates = true\nlisten = "unix:/run/upwash"\n[runtime]\nkind = "lxd"\n{REST}'
    with pytest.raises(ConfigError, match="over the network") as refusal:
        read(tmp_path, text)
    assert refusal.value.key == "runtime.kind"


def test_reading_configuration_imports_no_heavy_parts() -> None:
    loaded = modules_with("upwash.config.drone_file, upwash.config.daemon")
    assert not {"asyncio", "grpc", "cryptography", "numpy", "difflib", "upwash.ports"} & loaded


def test_a_daemon_loads_nothing_of_the_drones_program() -> None:
    of_the_drone = ("upwash.drone", "upwash.plans", "upwash.vehicle", "upwash.lab", "upwash.sim")
    loaded = modules_with("upwash.launch.daemon")
    assert not [name for name in loaded if name.startswith((*of_the_drone, "upwash.config.drone"))]


def modules_with(imported: str) -> set[str]:
    """The modules that a Python process has after this import."""
    script = f"import sys, {imported}; print(*sys.modules)"
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    return set(shown.split())


def test_a_service_may_stand_in_for_that_of_a_slower_computer(tmp_path: Path) -> None:
    paced = FULL.replace('name = "counter"\n', 'name = "counter"\npace_s = 2\nstart_pace_s = 8\n', 1).replace(
        'services:Detector"\n', 'services:Detector"\npace_s = { light = 0.2, heavy = 0.6 }\n'
    )
    detector, counter = read(tmp_path, paced).images
    assert (detector.pace_s, detector.start_pace_s) == ({"light": 0.2, "heavy": 0.6}, 0.0)
    assert (counter.pace_s, counter.start_pace_s) == ({"": 2.0}, 8.0)


DOCKER = 'kind = "docker"\nengine.addresses = '


@pytest.mark.parametrize(
    ("runtime", "key", "named"),
    [
        (
            'kind = "docker"\nengine.addresses = ["tcp://10.0.0.2:2375"]',
            "engine.addresses[0]",
            "an engine on this machine",
        ),
        (
            'kind = "docker"\nengine.addresses = ["unix:/a", "unix:/b"]',
            "engine.addresses",
            "one address .* is enough",
        ),
        (
            'devices = ["nvidia.com/gpu=0", "amd.com/gpu=0"]',
            "devices[1]",
            'or "nvidia.com/gpu=0", found "amd',
        ),
        ('devices = ["/dev/null", "/dev/../etc"]', "devices[1]", "expected a path below /dev"),
        ('kind = "lxd"\ndevices = ["/dev/dri"]', "devices", "by a profile: name it in engine.profiles"),
    ],
)
def test_what_docker_cannot_do_is_refused(tmp_path: Path, runtime: str, key: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named) as refusal:
        read(tmp_path, f"{KEYS}[runtime]\n{runtime}\n{REST}")
    assert refusal.value.key == f"runtime.{key}"


def test_docker_is_found_where_it_listens_by_itself(tmp_path: Path) -> None:
    runtime = read(tmp_path, f'{KEYS}[runtime]\nkind = "docker"\n{REST}').runtime
    assert runtime.engine_addresses == ("unix:/var/run/docker.sock",)
