"""A day of three servers: reloads, a lost drone, another program, a crash; what drones, inventory and alerts say."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import urllib.request
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from tests.children import gone
from tests.programs import ROOT, upwash
from tests.system.daemons import Daemon, config, daemon, guests, shown
from tests.system.flying import Flying
from tests.waiting import wait_for

from upwash.errors import LinkError, Unreachable
from upwash.real.trust.authority import make_keys, revoke

pytestmark = [pytest.mark.system, pytest.mark.long, pytest.mark.xdist_group("hand-over")]

NAMES = ("s1", "s2", "s3")
LOST = "south-2"
DRONES = ("north-1", "south-1", LOST)
SERVICE = """
from upwash import service

@service
class Level:
    def version(self) -> int:
        return {version}
"""
RULES_FILE = ROOT / "deploy" / "prometheus-alerts.yml"
RULES = {
    rule["alert"]: rule["expr"]
    for group in yaml.safe_load(RULES_FILE.read_text())["groups"]
    for rule in group["rules"]
}
Alert = tuple[str, str]  # its name, and the server that it is of; else the part
Firing = Callable[[], set[Alert]]
Watch = Callable[[Mapping[str, "Box"], Path], AbstractContextManager[Firing]]


class Box:
    """A server's machine: a folder with its configuration, service and keys, and the daemon that runs there."""

    def __init__(self, folder: Path, name: str, keys: Path, metrics: str) -> None:
        self.folder, self.name, self.metrics = folder, name, metrics
        (folder / "keys").mkdir(parents=True)
        for file in ("authority.pem", f"{name}.pem", f"{name}.key"):
            shutil.copy(keys / file, folder / "keys")
        self.install(1)
        own = {"certificate": f"{folder}/keys/{name}.pem", "key": f"{folder}/keys/{name}.key"}
        self.text = config(
            folder / "keys", keys=own, lease_s=3.0, metrics=metrics, server=[{"name": name, "slots": 4}],
            service=[{"name": "level", "program": "level.py:Level"}],
        )  # fmt: skip

    @contextmanager
    def running(self) -> Iterator[None]:
        with daemon(self.folder, self.text, names=self.name) as self.at:
            yield

    @property
    def process(self) -> int:
        return (self.at.process.pid, *self.at.successors())[-1]

    def install(self, version: int) -> None:
        (self.folder / "level.py").write_text(SERVICE.format(version=version))

    def configure(self, text: str) -> None:
        (self.folder / "server.toml").write_text(text)

    async def order(self, order: str) -> list[str]:
        """What of a reload or a check the daemon refuses; the command's exit code must say whether it does."""
        file = self.folder / "server.toml"
        done = await asyncio.to_thread(upwash, "serve", "--config", file, f"--{order}", str(self.process))
        refused = re.findall(r"^refused: ([^:]*):", done.stdout, re.MULTILINE)
        assert done.returncode == bool(refused), done.stdout + done.stderr
        return refused


class Day:
    """Three servers, the drones that call all of them all day, and what an operator does."""

    def __init__(self, keys: Path, boxes: Mapping[str, Box], firing: Firing) -> None:
        self.keys, self.boxes, self.firing = keys, boxes, firing
        self.enough = asyncio.Event()
        self.may_fail: set[str] = set()  # drones and servers
        self.drones: dict[tuple[str, str], Flying] = {}
        self.flights: dict[tuple[str, str], asyncio.Task[None]] = {}
        self.inventory = keys.parent / "boxes.toml"
        listed = (
            f'[[server]]\nname = "{name}"\naddress = "{box.at.address}"\n' for name, box in boxes.items()
        )
        self.inventory.write_text("".join(listed))

    @asynccontextmanager
    async def flying(self) -> AsyncIterator[None]:
        """Every drone calls every server until the end of the block."""
        async with asyncio.TaskGroup() as flights:
            here = asyncio.Semaphore(0)
            for drone in DRONES:
                for name, box in self.boxes.items():
                    program = f"{box.folder}/level.py:Level"
                    self.drones[drone, name] = Flying(
                        drone, box.at.address, self.keys, program, "version", server=name, pause_s=0.1
                    )
                    self.flights[drone, name] = flights.create_task(self._fly(drone, name, here.release))
            for _ in self.drones:
                await here.acquire()
            yield
            self.enough.set()

    async def _fly(self, drone: str, name: str, arrived: Callable[[], None]) -> None:
        try:
            await self.drones[drone, name].fly(self.enough, arrived)
        except LinkError:
            if self.may_fail.isdisjoint((drone, name)):
                raise

    async def call_on(self) -> None:
        """Returns when each drone that may call has had two more answers of each server that is there."""
        for ids, drone in self.drones.items():
            if self.may_fail.isdisjoint(ids):
                await drone.called()
                await drone.called()

    async def views(self) -> list[Any]:
        """What the inventory's command tells of the servers; its exit code must say whether all are well."""
        asks = ("status", "--inventory", self.inventory, "--operator", "alice", "--keys", self.keys, "--json")
        done = await asyncio.to_thread(upwash, *asks)
        views: list[Any] = json.loads(done.stdout)
        assert done.returncode == any(view["wrong"] for view in views), done.stdout + done.stderr
        return views

    async def wrong(self) -> dict[str, list[str]]:
        return {view["server"]: view["wrong"] for view in await self.views() if view["wrong"]}

    async def alerts_are(self, *expected: Alert) -> None:
        """Returns when these alerts fire, and no others."""
        wanted = set(expected)
        await asyncio.to_thread(wait_for, lambda: self.firing() == wanted, seen=self.firing)

    async def everywhere(self, order: str) -> list[list[str]]:
        return await asyncio.gather(*(box.order(order) for box in self.boxes.values()))


@contextmanager
def offered(boxes: Mapping[str, Box], _: Path) -> Iterator[Firing]:
    """The alerts whose expressions have the values that they ask for, without a Prometheus, and at once."""
    asked = {
        "UpwashServerGone": ("up == 0", "upwash_daemon_info"),
        "UpwashReloadRefused": ("upwash_reload_refused == 1",),
        "UpwashRefusedAtDoor": ("increase(upwash_door_refusals_total[10m]) > 5",),
        "UpwashReloadNotEverywhere": (
            "count by (job, part, digest) (upwash_in_force_since_timestamp_seconds{",
            'part=~"revocations|service .*"',
        ),
    }
    for alert, texts in asked.items():
        assert all(text in RULES[alert] for text in texts), f"read {alert} here as its rule has it now"
    seen: set[str] = set()
    refused: Counter[str] = Counter()  # by server, in all
    before: Counter[str] = Counter()  # by server, of the daemon that runs

    def firing() -> set[Alert]:
        found: set[Alert] = set()
        in_force: set[tuple[str, str]] = set()
        for name, box in boxes.items():
            try:
                families = list(text_string_to_metric_families(got(f"http://{box.metrics}/metrics")))
            except OSError:
                found |= {("UpwashServerGone", name)} if name in seen else set()
                continue
            samples = [sample for family in families for sample in family.samples]
            seen.update(name for sample in samples if sample.name == "upwash_daemon_info")
            total = sum(each.value for each in samples if each.name == "upwash_door_refusals_total")
            refused[name] += int(total - before[name] if total >= before[name] else total)
            before[name] = int(total)
            for sample in samples:
                if sample.name == "upwash_reload_refused" and sample.value == 1:
                    found.add(("UpwashReloadRefused", name))
                if sample.name == "upwash_in_force_since_timestamp_seconds":
                    in_force.add((sample.labels["part"], sample.labels["digest"]))
        versions = Counter(part for part, _ in in_force if re.fullmatch("revocations|service .*", part))
        found |= {("UpwashReloadNotEverywhere", part) for part, count in versions.items() if count > 1}
        return found | {("UpwashRefusedAtDoor", name) for name, times in refused.items() if times > 5}

    yield firing


@contextmanager
def prometheus(boxes: Mapping[str, Box], folder: Path) -> Iterator[Firing]:
    """The alerts that a Prometheus fires by the rules, without their times."""
    rules = re.sub(r"for: \d+m", "for: 0s", RULES_FILE.read_text())
    (folder / "alerts.yml").write_text(rules)
    targets = [box.metrics for box in boxes.values()]
    scrape = {"job_name": "upwash", "static_configs": [{"targets": targets}]}
    often = {"scrape_interval": "1s", "evaluation_interval": "1s"}
    document = {"global": often, "rule_files": ["alerts.yml"], "scrape_configs": [scrape]}
    (folder / "prometheus.yml").write_text(yaml.safe_dump(document))
    (address,) = free_addresses(1)
    command = (
        "prometheus", f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/data",
        f"--web.listen-address={address}",
    )  # fmt: skip
    name_of = {box.metrics: name for name, box in boxes.items()}

    def firing() -> set[Alert]:
        try:
            alerts = json.loads(got(f"http://{address}/api/v1/alerts"))["data"]["alerts"]
            count = json.loads(got(f"http://{address}/api/v1/query?query=count(upwash_daemon_info)"))
        except OSError:  # it starts
            return {("Prometheus", "")}
        if not count["data"]["result"]:
            return {("nothing read", "")}
        labels = [alert["labels"] for alert in alerts if alert["state"] == "firing"]
        return {(each["alertname"], name_of.get(each.get("instance"), each.get("part"))) for each in labels}

    with (folder / "prometheus.log").open("w") as log, subprocess.Popen(command, stderr=log) as process:
        try:
            yield firing
        finally:
            process.kill()


def got(url: str) -> str:
    with urllib.request.urlopen(url, timeout=5.0) as answer:
        return str(answer.read().decode())


def free_addresses(count: int) -> list[str]:
    """Addresses of this machine at which nobody listens."""
    with ExitStack() as stack:
        reserved = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in reserved:
            each.bind(("127.0.0.1", 0))
        return [f"127.0.0.1:{each.getsockname()[1]}" for each in reserved]


WITHOUT_PROMETHEUS = pytest.mark.skipif(
    shutil.which("prometheus") is None, reason="no prometheus here: Debian's package has it"
)


@pytest.mark.parametrize("watch", [offered, pytest.param(prometheus, marks=WITHOUT_PROMETHEUS)])
async def test_an_operators_day_at_three_servers_costs_no_call_of_a_drone_that_may_call(
    tmp_path: Path, watch: Watch
) -> None:
    keys = tmp_path / "keys"
    make_keys(keys, servers=[[name] for name in NAMES], drones=DRONES, operators=["alice"])
    ports = free_addresses(len(NAMES))
    boxes = {name: Box(tmp_path / name, name, keys, at) for name, at in zip(NAMES, ports, strict=True)}
    with ExitStack() as stack:
        for box in boxes.values():
            stack.enter_context(box.running())
        day = Day(keys, boxes, stack.enter_context(watch(boxes, tmp_path)))
        async with asyncio.timeout(200.0), day.flying():
            await begin(day)
            await reload_what_is_wrong(day)
            await reload_another_version(day)
            await lose_a_drone(day)
            await change_the_program(day)
            await lose_a_server(day)
    stay = [answered.answered for ids, answered in day.drones.items() if day.may_fail.isdisjoint(ids)]
    assert [list(dict.fromkeys(answered)) for answered in stay] == [[1, 2]] * 4


async def begin(day: Day) -> None:
    assert await day.wrong() == {}
    await day.alerts_are()
    await day.call_on()


async def reload_what_is_wrong(day: Day) -> None:
    box = day.boxes["s2"]
    box.configure(box.text.replace("slots = 4", "slots = 0"))
    assert await box.order("check") == ["configuration"]
    assert await box.order("reload") == ["configuration"]
    wrong = await day.wrong()
    assert list(wrong) == ["s2"] and any("slots" in why for why in wrong["s2"])
    await day.alerts_are(("UpwashReloadRefused", "s2"))
    await day.call_on()


async def reload_another_version(day: Day) -> None:
    for box in day.boxes.values():
        box.install(2)
        box.configure(box.text.replace("slots = 4", "slots = 5"))
    assert await day.boxes["s2"].order("reload") == []
    assert await day.wrong() == {"s2": ["service level: not as on the other servers"]}
    await day.alerts_are(("UpwashReloadNotEverywhere", "service level"))
    assert await day.everywhere("reload") == [[], [], []]
    for drone in day.drones.values():
        await drone.hears(2)
    views = await day.views()
    assert not any(view["wrong"] for view in views)
    for part in ("revocations", "service level"):
        assert len({view["reply"]["daemon"]["parts"][part]["digest"] for view in views}) == 1
    await day.alerts_are()


async def lose_a_drone(day: Day) -> None:
    listed = revoke(day.keys, [LOST])
    for box in day.boxes.values():
        shutil.copy(listed, box.folder / "keys")
    day.may_fail.add(LOST)
    assert await day.everywhere("reload") == [[], [], []]
    async with asyncio.timeout(8.0):  # a call that nobody ends takes 10 s
        await asyncio.gather(*(day.flights[LOST, name] for name in NAMES))
    await asyncio.gather(*(is_refused(day, box.at, name) for name, box in day.boxes.items()))
    assert await day.wrong() == {}
    await day.alerts_are(*AT_DOOR)
    await day.call_on()


AT_DOOR = [("UpwashRefusedAtDoor", name) for name in NAMES]


async def is_refused(day: Day, at: Daemon, name: str) -> None:
    """The lost drone gets no answer, as often as it asks."""
    program = f"{day.boxes[name].folder}/level.py:Level"
    for _ in range(8):
        async with guests(at, program, (LOST, shown(day.keys, LOST), name)) as (guest,):
            with pytest.raises(Unreachable):
                await guest.availability("level")


async def change_the_program(day: Day) -> None:
    for box in day.boxes.values():
        box.at.process.send_signal(signal.SIGUSR2)
        await asyncio.to_thread(box.at.has_said, "has taken this daemon's place")
        await day.call_on()
    for box in day.boxes.values():
        assert await asyncio.to_thread(box.at.process.wait) == 0
    await day.call_on()
    assert await day.wrong() == {}
    await asyncio.gather(*(is_refused(day, box.at, name) for name, box in day.boxes.items()))
    await day.alerts_are(*AT_DOOR)


async def lose_a_server(day: Day) -> None:
    day.may_fail.add("s3")
    os.kill(day.boxes["s3"].process, signal.SIGKILL)
    assert gone(day.boxes["s3"].process)
    await asyncio.gather(*(day.flights[drone, "s3"] for drone in DRONES))
    await day.call_on()
    wrong = await day.wrong()
    assert list(wrong) == ["s3"] and "nobody serves there" in wrong["s3"][0]
    await day.alerts_are(*AT_DOOR, ("UpwashServerGone", "s3"))
