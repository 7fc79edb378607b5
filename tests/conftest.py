"""What tests of several folders share: certificates, and services that other processes can import."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gc
import inspect
import os
import shutil
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from tests import podman as podmans
from tests.engines import Kind, OwnEngine, own_engine, why_not
from tests.podman import OwnPodman
from tests.programs import ROOT, ended
from tests.system.container_site import image_of
from tests.system.fake_networkmanager import bus_daemon
from tests.system.radios import Field, field_below

from upwash.cli.main import main
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import Credentials, read_credentials
from upwash.sim.loop import run_virtually

SCENARIOS = ROOT / "scenarios"
LANES = (  # groups that fly in real time: one process runs those of a lane, as more at once would be late
    ("flights-0",),
    ("flights-1", "emulate"),
    ("podman", "browser", "ns3"),
    ("lxd", "incus", "tutorial"),
)
LANE_OF = {group: f"lane-{number}" for number, lane in enumerate(LANES) for group in lane}
ON_VIRTUAL_TIME = ("sim", "lab", "core")  # folders of tests, those of long tests first
YIELDS = 5  # by which their priority is lower
PRIORITY = os.getpriority(os.PRIO_PROCESS, 0)

# A busy machine breaks nothing.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


def pytest_configure() -> None:
    """Has the tests, and what they start, hear of the terminal's signals, which a shell keeps from its background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGQUIT) is signal.SIG_IGN:
        signal.signal(signal.SIGQUIT, signal.SIG_DFL)
    gc.disable()


def pytest_collection_finish() -> None:
    """Leaves the thousands of tests, which stay until the end, out of each later search for garbage."""
    gc.freeze()
    gc.enable()


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Keeps values of up to ten million characters out of the names that go with each report."""
    return f"{argname}-of-{len(val)}" if isinstance(val, str | bytes) and len(val) > 150 else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Lets lanes begin first, beside tests that yield to them; then those that wait fill the gaps of the others."""
    flights = [item for item in items if item.get_closest_marker("flight") and _group(item) is None]
    for number, flight in enumerate(flights):  # each renders photos and detects, as real drones would
        flight.add_marker(pytest.mark.xdist_group(f"flights-{number % 2}"))
    for item in items:  # what a module's tests share is made once, and not by every process
        if _shares_with_its_module(item) and _group(item) is None:
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    others = [item for item in items if _group(item) not in LANE_OF]
    yielding = sorted(filter(_yields, others), key=lambda item: ON_VIRTUAL_TIME.index(_folder(item)))
    rest = [item for item in others if not _yields(item)]
    waiting = [item for item in rest if item.get_closest_marker("system")]
    computing = [item for item in rest if not item.get_closest_marker("system")]
    in_lanes = [(item, LANE_OF[group]) for group in LANE_OF for item in items if _group(item) == group]
    for item, lane in in_lanes:
        _move(item, lane)
    items[:] = [item for item, _ in in_lanes] + yielding + _merged(waiting, computing)


def _move(item: pytest.Item, lane: str) -> None:
    """Puts a lane in the place of the item's group."""
    for node in item.listchain():
        node.own_markers = [
            mark for mark in node.own_markers if mark.name != "xdist_group" or mark.args[0] not in LANE_OF
        ]
    item.add_marker(pytest.mark.xdist_group(lane))


def _group(item: pytest.Item) -> str | None:
    mark = item.get_closest_marker("xdist_group")
    return str(mark.args[0]) if mark is not None else None


def _merged(*lists: list[pytest.Item]) -> list[pytest.Item]:
    """All of them, so that each list is used up evenly."""
    placed = [(place / len(items), item) for items in lists for place, item in enumerate(items)]
    return [item for _, item in sorted(placed, key=lambda pair: pair[0])]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Lets tests on virtual time yield the processor to flights in real time, which run beside them."""
    if _takes_its_priority_back():
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY + YIELDS * _yields(item))
    return (yield)


def _yields(item: pytest.Item) -> bool:
    return _folder(item) in ON_VIRTUAL_TIME


def _folder(item: pytest.Item) -> str:
    return item.path.relative_to(item.config.rootpath).parts[1]


@functools.cache
def _takes_its_priority_back() -> bool:
    """Whether this process may: root may, but in a container that was started without CAP_SYS_NICE."""
    if os.geteuid() != 0:
        return False
    os.setpriority(os.PRIO_PROCESS, 0, PRIORITY + 1)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    except PermissionError:
        return False
    return True


def _shares_with_its_module(item: pytest.Item) -> bool:
    known = getattr(item, "_fixtureinfo", None)
    found = known.name2fixturedefs.values() if known is not None else ()
    return any(definition.scope == "module" for definitions in found for definition in definitions)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Runs a test that is a coroutine: on virtual time if it is marked so, else in real time.

    A fixture that is an asynchronous context manager is entered, and the test gets what that yields.
    """
    test = pyfuncitem.obj
    if not inspect.iscoroutinefunction(test):
        return None

    async def enter_and_test() -> None:
        async with contextlib.AsyncExitStack() as stack:
            given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(test).parameters}
            for name, value in given.items():
                if isinstance(value, contextlib.AbstractAsyncContextManager):
                    given[name] = await stack.enter_async_context(value)
            await test(**given)

    (run_virtually if pyfuncitem.get_closest_marker("virtual") else asyncio.run)(enter_and_test())
    return True


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority, a daemon that is s1 and s2, the drones heron and stork; below `other`, a stranger's heron."""
    folder = tmp_path_factory.mktemp("keys")
    make_keys(folder, servers=[["s1", "s2"]], drones=["heron", "stork"])
    make_keys(folder / "other", servers=[["s1", "s2"]], drones=["heron"])
    return folder


@pytest.fixture(scope="session")
def credentials(keys: Path) -> Callable[[str], Credentials]:
    """The credentials of a holder, such as `heron` or `other/heron`."""

    def read(holder: str) -> Credentials:
        certificate = keys / f"{holder}.pem"
        return read_credentials(certificate.parent / "authority.pem", certificate, keys / f"{holder}.key")

    return read


@pytest.fixture(scope="session")
def services() -> Path:
    """The file of the services that tests start in processes of their own."""
    return Path(__file__).parent / "services_for_tests.py"


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The log of the thesis's mission, and of the same without offloading."""
    folder = tmp_path_factory.mktemp("logs")
    thesis = str(SCENARIOS / "thesis.toml")
    assert main(["simulate", thesis, "--log", str(folder / "with.jsonl")]) == 0
    assert main(["simulate", thesis, "--policy", "local-only", "--log", str(folder / "without.jsonl")]) == 0
    return folder / "with.jsonl", folder / "without.jsonl"


@pytest.fixture(scope="session")
def lxd() -> Iterator[OwnEngine]:
    """An LXD of the tests' own."""
    yield from _engine("lxd")


@pytest.fixture(scope="session")
def incus() -> Iterator[OwnEngine]:
    """An Incus of the tests' own."""
    yield from _engine("incus")


def _engine(kind: Kind) -> Iterator[OwnEngine]:
    if why := why_not(kind):
        pytest.skip(why)
    with own_engine(kind) as engine:
        yield engine


@pytest.fixture(scope="session")
def workbench_image(services: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The image of the workbench."""
    return image_of(f"{services}:Workbench", tmp_path_factory.mktemp("images"))


@pytest.fixture(scope="session")
def podman() -> Iterator[OwnPodman]:
    """A Podman of the tests' own."""
    if why := podmans.why_not():
        pytest.skip(why)
    with podmans.own_podman() as engine:
        yield engine


@pytest.fixture(scope="session")
def docker_images(services: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Images of the workbench and the vandal, as Docker and Podman take them."""
    folder = tmp_path_factory.mktemp("images")
    return [image_of(f"{services}:{cls}", folder, "docker") for cls in ("Workbench", "Vandal")]


@pytest.fixture(scope="session")
def detail(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's program, compiled."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ here: tests/system/install-packages installs it")
    program = tmp_path_factory.mktemp("program") / "detail"
    source = ROOT / "examples/other-languages/detail.cpp"
    made = ended(["g++", "-std=c++17", "-O1", source, "-o", program])
    if "nlohmann/json.hpp: No such file" in made.stderr:
        pytest.skip("no nlohmann/json.hpp here: tests/system/install-packages installs it")
    assert made.returncode == 0, made.stderr
    return program


@pytest.fixture
def private_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A bus of the test's own, in the place of the system's."""
    with bus_daemon(tmp_path) as address:
        monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", address)
        yield


@pytest.fixture
def field(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Field]:
    """Radios that are cables, and a NetworkManager of their own in the place of the system's."""
    yield from field_below(tmp_path, monkeypatch)
