"""Orders, lost lists, slow disks, services that hang and hand-overs at any moment, on virtual time.

What an operator ordered holds within a second, or the log and the status say what does not.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.server.test_edge_server import IMAGES, Runtime

from upwash.config.daemon import DaemonConfig
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.errors import UpwashError, UsageError
from upwash.launch.confinement import Confinement
from upwash.launch.daemon_keys import DaemonKeys
from upwash.launch.daemon_reload import ConfigFile, Reloads, _tried
from upwash.launch.daemon_services import DaemonServices, Services
from upwash.launch.in_force import CONFIGURATION, REVOCATIONS, InForce
from upwash.real.host.service_manager import ServiceManager
from upwash.real.trust.authority import make_keys
from upwash.rpc.protocol import AVAILABILITY, AvailabilityReply, AvailabilityRequest
from upwash.server.daemon import EdgeServer
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.support.background import end

T = TypeVar("T")
Plant = Callable[[pytest.MonkeyPatch], None]
CONFIG = """
listen = "127.0.0.1:0"
{more}
[keys]
authority = "{keys}/authority.pem"
certificate = "{keys}/s1.pem"
key = "{keys}/s1.key"
revoked = "{listed}.txt"
[[service]]
name = "detector"
[[server]]
name = "s1"
slots = 9
"""
DRONES = {"d1": "0a" * 32, "d2": "0b" * 32, "d3": "0c" * 32}
LEASE_S = 30.0
SOON_S = 0.9
READ_S = 5.0
HUNG_S = 1000.0
COMES_UP_S = 20.0  # a successor
START_TIMEOUT_S = 60.0


class Disk:
    """The files of a daemon, and for how long each kind of them is not answered."""

    def __init__(self, folder: Path, keys: Path) -> None:
        self.folder, self.keys = folder, keys
        self.takes_s = {"toml": 0.0, "txt": 0.0}
        self.listed = "revoked"
        self.is_broken = self.has_other_leases = False
        self.file = ConfigFile(folder / "server.toml")
        self.put("revoked", [])
        self.put("other", [])
        self.write()

    def write(self) -> None:
        more = "lease_s = 40" if self.has_other_leases else ""
        text = CONFIG.format(more=more, keys=self.keys, listed=self.listed)
        self.file.path.write_text("[[" if self.is_broken else text)

    def put(self, name: str, drones: list[str] | None, rest: str = "") -> None:
        file = self.folder / f"{name}.txt"
        file.unlink(missing_ok=True)
        if drones is not None:
            file.write_text("".join(f"{DRONES[drone]}  {drone}\n" for drone in drones) + rest)

    async def read(self, work: Callable[[], T], *, name: str) -> T:
        await asyncio.sleep(self.takes_s[name.rpartition(".")[2]] if "." in name else 0.0)
        return work()


class Imports(DaemonServices):
    """Services whose code is loaded as a test has it."""

    def __init__(self) -> None:
        super().__init__(Confinement())
        self.images = dict(IMAGES)
        self.takes_s = 0.5
        self.refused = ""

    async def anew(self, config: DaemonConfig) -> Services:
        self.looking.add("detector")
        try:
            await asyncio.sleep(min(self.takes_s, START_TIMEOUT_S))
        finally:
            self.looking.discard("detector")
        if self.refused or self.takes_s > START_TIMEOUT_S:
            raise UsageError(self.refused or "detector is not loaded")
        return Services(IMAGES)


class Daemon:
    """A daemon that takes orders, perhaps in the place of another, to which it passes them on."""

    def __init__(self, disk: Disk, imports: Imports, before: Daemon | None = None) -> None:
        config, _ = disk.file.read()
        self.before = before
        revoked: frozenset[str] = before.keys.revoked if before else frozenset()
        self.keys: DaemonKeys = DaemonKeys(config, revoked=revoked)
        self.in_force = InForce(self.keys, code="", sandbox="none")
        self.edge = EdgeServer(
            AdmissionController({"s1": ServerOffer(frozenset(IMAGES), 9)}),
            images=IMAGES,
            runtime=Runtime(),
            dialer=ModelDialer("s1", Switchboard({})),
            start_timeout_s=START_TIMEOUT_S,
            drain_s=10.0,
        )
        self.edge.revoke(self.keys.revoked)
        self.reloads = Reloads(
            disk.file,
            config,
            edge=self.edge,
            services=imports,
            keys=self.keys,
            door=None,
            manager=ServiceManager(""),
            in_force=self.in_force,
            pass_on=self.pass_on,
            reading=disk.read,
        )
        self.obeying = asyncio.create_task(self.reloads.run())

    def pass_on(self) -> None:
        if self.before is not None:
            self.before.reloads.ask("the daemon after")

    async def refuses(self) -> frozenset[str]:
        """The drones that get no slot."""
        refused = set()
        for drone, certificate in DRONES.items():
            request = msgspec.msgpack.encode(AvailabilityRequest("s1", []))
            said = await self.edge.handle(AVAILABILITY, request, Client(drone, certificate))
            if not msgspec.msgpack.decode(said, type=AvailabilityReply).available:
                refused.add(drone)
        return frozenset(refused)

    async def close(self) -> None:
        self.obeying.cancel()
        await asyncio.gather(self.obeying, return_exceptions=True)
        await self.edge.close()


@dataclass(frozen=True)
class Step:
    """What happens, and how much later the next step comes."""

    what: str
    drones: tuple[str, ...] = ()
    name: str = "revoked"
    takes_s: float = 0.0
    then_s: float = 0.0


some_drones = st.lists(st.sampled_from(sorted(DRONES)), unique=True, max_size=3).map(tuple)
steps = st.lists(
    st.builds(
        Step,
        what=st.sampled_from(
            [
                "list",
                "list",
                "order",
                "order",
                "lose",
                "break",
                "config",
                "leases",
                "name",
                "disk",
                "import",
                "succeed",
            ]
        ),
        drones=some_drones,
        name=st.sampled_from(["revoked", "other"]),
        takes_s=st.sampled_from([0.0, 0.3, 3.0, 8.0, HUNG_S]),
        then_s=st.sampled_from([0.0, 0.1, 0.7, 2.0, 11.0, 70.0]),
    ),
    max_size=12,
)


class World:
    """Plays steps, and knows what must hold after an order."""

    def __init__(self, folder: Path, keys: Path, said: list[str]) -> None:
        self.disk, self.imports, self.said = Disk(folder, keys), Imports(), said
        self.daemon = Daemon(self.disk, self.imports)
        self.coming: asyncio.Task[None] | None = None

    async def play(self, story: list[Step]) -> None:
        for step in story:
            await self.do(step)
            await asyncio.sleep(step.then_s)
        await self.must_hold()
        for daemon in self.daemons():
            await daemon.close()

    async def do(self, step: Step) -> None:
        disk = self.disk
        match step.what:
            case "list":
                disk.put(step.name, list(step.drones))
            case "lose":
                disk.put(step.name, None)
            case "break":
                disk.put(step.name, list(step.drones), "no fingerprint\n")
            case "config":
                disk.is_broken = not disk.is_broken
            case "leases":
                disk.has_other_leases = not disk.has_other_leases
            case "name":
                disk.listed = step.name
            case "disk":
                disk.takes_s["toml"] = step.takes_s
            case "import":
                self.imports.takes_s = step.takes_s
            case "order":
                await self.order()
            case "succeed" if self.coming is None:
                self.coming = asyncio.create_task(self.succeed())
        disk.write()

    async def order(self) -> asyncio.Future[Mapping[str, str]]:
        known = len(self.said)
        ordered = self.daemon.reloads.ask("SIGHUP")
        assert len(self.said) > known, "an order has no answer"
        return ordered

    async def succeed(self) -> None:
        """As `hand_over_at` and the successor do it."""
        former, count = self.daemon, self.daemon.reloads.count
        try:
            successor = Daemon(self.disk, self.imports, former)
        except UpwashError:  # the former stays
            self.coming = None
            return
        expected = self.in_file(self.disk.listed) or await former.refuses()
        assert await successor.refuses() == expected, "a successor forgets revocations"
        await asyncio.sleep(COMES_UP_S)
        self.daemon, former.reloads.is_leaving = successor, True
        if former.reloads.count > count:
            successor.reloads.ask("the daemon before")

    def daemons(self) -> list[Daemon]:
        return [self.daemon, *([self.daemon.before] if self.daemon.before else [])]

    async def must_hold(self) -> None:
        """What is ordered last holds in every daemon within a second, and what was refused is said."""
        if self.coming is not None:
            await self.coming
        before = {daemon: await daemon.refuses() for daemon in self.daemons()}
        takes_s = self.disk.takes_s["toml"]
        soon = {daemon: self.listed(daemon, within_s=SOON_S) for daemon in self.daemons()}
        listed = self.listed(self.daemon, within_s=READ_S)
        ordered = await self.order()
        await asyncio.sleep(SOON_S)
        for daemon, order in soon.items():
            is_lost = order is None or (bool(before[daemon]) and not order)
            expected = before[daemon] if is_lost else order
            assert await daemon.refuses() == expected, "a revocation is late"
        async with asyncio.timeout(3 * START_TIMEOUT_S):
            refused = await ordered
        is_lost = listed is None or (not listed and bool(before[self.daemon]))
        assert (REVOCATIONS in refused) == is_lost, "a lost list is not told"
        config_is_read = not self.disk.is_broken and takes_s < READ_S
        needs_restart = self.disk.has_other_leases == (self.daemon.reloads.config.lease_s == LEASE_S)
        is_taken = config_is_read and not needs_restart and self.imports.takes_s <= START_TIMEOUT_S
        if config_is_read:
            assert (REVOCATIONS in refused) == is_lost, "a lost list is not told"
        assert (CONFIGURATION in refused) == (not is_taken), "a refused configuration is not told"
        status = self.daemon.in_force.status()
        assert status.reload is not None
        assert status.reload.ended is not None, "the status has a reload that is over as under way"
        assert {part for part, known in status.parts.items() if known.refused} == set(refused)
        assert status.revoked == len(await self.daemon.refuses())

    def listed(self, daemon: Daemon, *, within_s: float) -> frozenset[str] | None:
        """The drones of the list that counts for an order after that time; None where it cannot be read."""
        table, name = daemon.reloads._listed, self.disk.listed
        if table is not None and (self.disk.is_broken or self.disk.takes_s["toml"] >= within_s):
            name = table.list_of_revoked.stem
        return self.in_file(name)

    def in_file(self, name: str) -> frozenset[str] | None:
        file = self.disk.folder / f"{name}.txt"
        text = file.read_text() if file.exists() else "no fingerprint"
        if "no fingerprint" in text:
            return None
        return frozenset(drone for drone, digits in DRONES.items() if digits in text)


async def play(folder: Path, keys: Path, said: list[str], story: list[Step]) -> None:
    await World(folder, keys, said).play(story)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, servers=[["s1"]])
    return folder


@contextlib.contextmanager
def heard() -> Iterator[list[str]]:
    """The lines of the daemon's log."""

    class Lines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    said = list[str]()
    log, lines = logging.getLogger("upwash.serving"), Lines()
    log.addHandler(lines)
    level = log.level
    log.setLevel(logging.INFO)
    try:
        yield said
    finally:
        log.removeHandler(lines)
        log.setLevel(level)


def test_what_is_ordered_at_any_moment_holds_soon_or_is_told(tmp_path: Path, keys: Path) -> None:
    @settings(derandomize=True, database=None, max_examples=100)
    @given(story=steps)
    def worlds(story: list[Step]) -> None:
        run_virtually(play(tmp_path, keys, said, story))

    with heard() as said:
        worlds()


# --- planted defects ------------------------------------------------------------------------------------------


async def after_the_configuration(self: Reloads, keys: Any, known: Any, *, real: Any) -> str:
    await _tried(self._read_config())
    return await real(self, keys, known)  # type: ignore[no-any-return]


async def believes_an_empty_list(self: Reloads, keys: Any, _: Any, *, real: Any) -> frozenset[str]:
    return await real(self, keys, frozenset())  # type: ignore[no-any-return]


async def waits_for_the_older(*tasks: asyncio.Task[Any] | None) -> None:
    for task in tasks:
        if task is not None and getattr(task.get_coro(), "__name__", "") == "_reload":
            await asyncio.wait([task])
        else:
            await end(task)


def patched(method: str, defect: Callable[..., Coroutine[Any, Any, Any]]) -> Plant:
    def plant(patches: pytest.MonkeyPatch) -> None:
        real = getattr(Reloads, method)
        patches.setattr(Reloads, method, lambda self, *given: defect(self, *given, real=real))

    return plant


def forgets_the_daemon_before(patches: pytest.MonkeyPatch) -> None:
    real = DaemonKeys.__init__
    patches.setattr(DaemonKeys, "__init__", lambda self, config, **_: real(self, config))


def passes_nothing_on(patches: pytest.MonkeyPatch) -> None:
    patches.setattr(Daemon, "pass_on", lambda _: None)


def notes_no_refusal(patches: pytest.MonkeyPatch) -> None:
    patches.setattr(InForce, "refuse", lambda *_: None)


def waits_for_older_orders(patches: pytest.MonkeyPatch) -> None:
    patches.setattr("upwash.launch.daemon_reload.end", waits_for_the_older)


REVOKED = [Step("list", ("d1",)), Step("order", then_s=2.0)]
PLANTED: dict[str, tuple[Plant, list[Step]]] = {
    "revocations wait for the configuration": (
        patched("_renew_revoked", after_the_configuration),
        [Step("disk", takes_s=HUNG_S), Step("list", ("d1",))],
    ),
    "an empty list takes revocations back": (
        patched("_read_revoked", believes_an_empty_list),
        [*REVOKED, Step("list")],
    ),
    "a newer order waits for the older": (
        waits_for_older_orders,
        [Step("import", takes_s=HUNG_S), Step("order", then_s=2.0), Step("list", ("d1",))],
    ),
    "a successor forgets what was revoked": (
        forgets_the_daemon_before,
        [*REVOKED, Step("list"), Step("succeed", then_s=70.0)],
    ),
    "the daemon before hears of no order": (
        passes_nothing_on,
        [Step("succeed", then_s=70.0), Step("list", ("d1",))],
    ),
    "a refused part is not noted": (notes_no_refusal, [Step("config")]),
}


@pytest.mark.parametrize("what", PLANTED)
def test_a_planted_defect_is_found(
    tmp_path: Path, keys: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    plant, story = PLANTED[what]
    with heard() as said:
        run_virtually(play(tmp_path, keys, said, story))
        plant(monkeypatch)
        with pytest.raises((AssertionError, TimeoutError)):
            run_virtually(play(tmp_path, keys, said, story))
