"""What a service in a sandbox cannot do: whatever it tries, its neighbours and the machine are as before."""

from __future__ import annotations

import contextlib
import itertools
import json
import mmap
import os
import platform
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.children import children, expect_no_child

from upwash.core.admission.limits import Limits
from upwash.errors import InstanceError, LinkError, UsageError
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.local_instance import LocalInstance
from upwash.real.instances.runtime import ProcessRuntime
from upwash.real.instances.sandbox import Sandbox, code_of, files_in, find_sandbox, open_call_filter
from upwash.real.instances.syscalls import call_filter
from upwash.real.link.link import GrpcDialer
from upwash.rpc.protocol import service_path
from upwash.rpc.service import load_service, spec_of

pytestmark = pytest.mark.sandbox

PROGRAM = f"{Path(__file__).parents[1] / 'mischief.py'}:Mischief"
LIMITS = Limits(memory_bytes=2**28, processes=96, disk_bytes=2**22)
SPEC = InstanceSpec("s1", "mischief", Program(PROGRAM), limits=LIMITS)
MAX_MESSAGE_BYTES = 2**20
DEVICES = ("/dev/fuse", "/dev/hwrng", "/dev/loop-control", "/dev/kvm")  # that no sandbox has by itself
CALL_S = 8.0
NOBODY = ("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups")

Call = Callable[..., Awaitable[Any]]


@pytest.fixture(scope="module")
def sandbox() -> Sandbox:
    try:
        return find_sandbox(readable=())
    except UsageError as error:
        pytest.skip(str(error))


@asynccontextmanager
async def in_sandbox(sandbox: Sandbox, folder: Path) -> AsyncIterator[tuple[Call, LocalInstance]]:
    """An instance of the mischief and its calls, beside a neighbour that must answer before and after."""
    runtime = processes(sandbox, folder)
    dialer = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES)
    methods = spec_of(load_service(PROGRAM)).methods
    instances = [await runtime.start(SPEC, called=lambda _: None) for _ in range(2)]
    links = [dialer.dial(instance.endpoint, server="s1") for instance in instances]

    async def call(name: str, *arguments: object, at: int = 0, **named: object) -> Any:
        method = methods[name]
        _, request = method.encode(arguments, named)
        reply = await links[at].request(service_path("mischief", name), request, timeout_s=CALL_S)
        return method.result(method.decode(reply))

    try:
        for instance in instances:
            await instance.admit(frozenset({"heron"}))
        seen = await call("processes", at=1)
        yield call, instances[0]
        assert set(await call("processes", at=1)) >= set(seen), "the neighbour is not as before"
    finally:
        for link, instance in zip(links, instances, strict=True):
            await link.close()
            await instance.stop()
    expect_no_child()


def processes(sandbox: Sandbox, folder: Path) -> ProcessRuntime:
    numbers = itertools.count()
    return ProcessRuntime(
        lambda _: f"unix:{folder}/{next(numbers)}.sock", max_message_bytes=MAX_MESSAGE_BYTES, sandbox=sandbox
    )


async def test_it_gets_no_more_memory_than_its_limit_and_goes_on(sandbox: Sandbox, tmp_path: Path) -> None:
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        assert await call("eat_memory", 2**30) < LIMITS.memory_bytes
        assert await call("eat_memory", 2**25) == 2**25


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="there is one processor")
async def test_instances_that_may_use_one_processor_are_spread_over_all(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    before, runtime = set(children(os.getpid())), processes(sandbox, tmp_path)
    spec = replace(SPEC, limits=replace(LIMITS, cpus=1))
    instances = [await runtime.start(spec, called=lambda _: None) for _ in range(2)]
    first, second = (os.sched_getaffinity(each) for each in set(children(os.getpid())) - before)
    for instance in instances:
        await instance.stop()
    assert len(first) == len(second) == 1
    assert first != second


@pytest.mark.skipif(os.geteuid() != 0, reason="a user without rights has run them already")
@pytest.mark.usefixtures("sandbox")
def test_all_that_follows_holds_for_a_daemon_of_a_user_without_rights() -> None:
    with tempfile.TemporaryDirectory() as folder:
        os.chown(folder, 65534, 65534)
        environment = {**os.environ, "HOME": folder, "PYTHONDONTWRITEBYTECODE": "1"}
        python = (
            *NOBODY,
            "env",
            sys.executable,
        )  # setpriv itself has root's rights until it has run something
        if subprocess.run((*python, "-c", "import upwash"), env=environment, check=False).returncode != 0:
            pytest.skip("a user without rights cannot read this Python, or upwash")
        pytest_alone = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "--basetemp", f"{folder}/tests")
        done = subprocess.run(
            (*python, *pytest_alone, __file__), env=environment, capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stdout
    assert "may not make a sandbox" not in done.stdout


@pytest.mark.skipif(os.geteuid() == 0, reason="Linux does not limit the processes of root")
async def test_it_gets_no_more_processes_than_its_limit(sandbox: Sandbox, tmp_path: Path) -> None:
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        with contextlib.suppress(LinkError):  # gRPC in it could start no thread any more, or ended it
            assert await call("fork", 500) < LIMITS.processes
        assert await call("fork", 10, at=1) == 10, "its neighbour has processes of its own"


async def test_processes_that_it_left_behind_end_with_it(sandbox: Sandbox, tmp_path: Path) -> None:
    async with in_sandbox(sandbox, tmp_path) as (call, instance):
        assert await call("fork", 10) == 10
        assert len(await call("processes")) >= 12
        await instance.stop()
        assert sleeping_here(str(tmp_path)) == []


def sleeping_here(folder: str) -> list[str]:
    """The processes of this machine whose command names the folder: those of instances that began in it."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            command = (entry / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if "upwash.real.instances.instance" in command and folder in command:
            found.append(entry.name)
    return found


async def test_it_can_write_nowhere_but_into_its_own_tmp_and_no_more_than_its_limit(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    before = sorted(tmp_path.iterdir())
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        assert 0 < await call("fill", "/tmp", 2**26) <= LIMITS.disk_bytes
        assert await call("fill", "/dev/shm", 2**26) <= LIMITS.disk_bytes
        for folder in ("/", "/dev", "/usr", "/etc", str(Path(PROGRAM).parent), str(tmp_path), sys.prefix):
            assert await call("fill", folder, 2**26) == 0, folder
    assert [each for each in tmp_path.iterdir() if each.suffix != ".sock"] == before


async def test_it_reads_its_own_code_and_what_it_is_given_and_no_other_file_of_the_user(
    sandbox: Sandbox, tmp_path: Path, keys: Path
) -> None:
    model = tmp_path / "model.bin"
    model.write_text("weights")
    given = Sandbox(sandbox.bubblewrap, readable=(model,))
    async with in_sandbox(given, tmp_path) as (call, _):
        assert "class Mischief" in await call("read", PROGRAM.rpartition(":")[0])
        assert await call("read", str(model)) == "weights"
        for secret in (keys / "s1.key", keys / "authority.key", Path.home() / ".profile", Path(__file__)):
            assert await call("read", str(secret)) == "FileNotFoundError", secret


def test_it_uses_the_devices_that_it_is_given_and_no_others(sandbox: Sandbox) -> None:
    device = next((name for name in DEVICES if can_open(name)), None)
    if device is None:
        pytest.skip(f"none of {', '.join(DEVICES)} can be opened here")

    def opens(devices: tuple[str, ...]) -> str:
        tried = f"import os; os.close(os.open({device!r}, os.O_RDWR)); print(sorted(os.listdir('/dev')))"
        with open_call_filter(devices=devices) as inherited:
            command = sandbox.wrap([sys.executable, "-c", tried], call_filter=inherited, devices=devices)
            done = subprocess.run(command, capture_output=True, text=True, check=False, pass_fds=(inherited,))
        return done.stdout or done.stderr

    without, given = opens(()), opens((device,))
    assert "FileNotFoundError" in without
    assert [each for each in DEVICES if each.rpartition("/")[2] in given] == [device]


def can_open(device: str) -> bool:
    try:
        os.close(os.open(device, os.O_RDWR))
    except OSError:
        return False
    return True


# Prints what a service has of a graphics card, in a sandbox with those devices.
WITH_DEVICES = """
import subprocess, sys
from upwash.real.instances.cards import device_files
from upwash.real.instances.sandbox import Sandbox, open_call_filter
devices = device_files(sys.argv[2:])
with open_call_filter(devices=devices) as inherited:
    command = Sandbox("bwrap").wrap([sys.executable, "-c", sys.argv[1]], call_filter=inherited, devices=devices)
    sys.exit(subprocess.run(command, pass_fds=(inherited,)).returncode)
"""
SEES = """
import json, mmap, os
def works(do):
    try:
        do()
    except OSError:
        return False
    return True
print(json.dumps({
    "devices": sorted(name for name in os.listdir("/dev") if name.startswith("nvidia")),
    "driver": os.path.exists("/sys/module/nvidia/initstate"),
    "another driver": os.path.exists("/sys/module/other"),
    "names a thread": works(lambda: open(f"/proc/self/task/{os.getpid()}/comm", "w").write("cuda")),
    "shares memory": works(lambda: mmap.mmap(-1, 4096)) and works(lambda: os.memfd_create("cuda")),
    "sets the kernel": works(lambda: open("/proc/sys/kernel/core_pattern", "r+")),
    "changes the driver": works(lambda: open("/sys/module/nvidia/initstate", "w")),
}))
"""
WITHOUT_CARD = {
    "devices": [],
    "driver": False,
    "another driver": False,
    "names a thread": False,
    "shares memory": False,
    "sets the kernel": False,
    "changes the driver": False,
}
DRIVER = "/sys/module/nvidia/initstate"


@pytest.mark.parametrize(
    ("named", "seen"),
    [
        ([], []),
        (["/dev/null"], []),
        (["nvidia.com/gpu=1"], ["nvidia-uvm", "nvidia1", "nvidiactl"]),
        (["nvidia.com/gpu=all"], ["nvidia-uvm", "nvidia0", "nvidia1", "nvidiactl"]),
        (["/dev/nvidia0", "/dev/nvidiactl"], ["nvidia0", "nvidiactl"]),
    ],
)
def test_with_a_card_it_has_what_cuda_needs_and_without_one_nothing_of_it(
    sandbox: Sandbox, tmp_path: Path, named: list[str], seen: list[str]
) -> None:
    (tmp_path / "live").write_text("live\n")
    machine = [sandbox.bubblewrap, "--dev-bind", "/", "/", "--dev", "/dev"]  # with two cards that do nothing
    for name in ("nvidia0", "nvidia1", "nvidiactl", "nvidia-uvm"):
        machine += ["--dev-bind", "/dev/null", f"/dev/{name}"]
    machine += ["--tmpfs", "/sys/module", "--bind", f"{tmp_path}/live", DRIVER, "--dir", "/sys/module/other"]
    done = subprocess.run(
        [*machine, "--", sys.executable, "-c", WITH_DEVICES, SEES, *named],
        capture_output=True,
        text=True,
        check=False,
    )
    if not seen:
        assert (json.loads(done.stdout or "{}"), done.stderr) == (WITHOUT_CARD, "")
        return
    has = {"devices": seen, "driver": True, "shares memory": True, "names a thread": os.geteuid() != 0}
    assert (json.loads(done.stdout or "{}"), done.stderr) == (WITHOUT_CARD | has, "")


async def test_it_reaches_nobody(sandbox: Sandbox, tmp_path: Path) -> None:
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.socket(socket.AF_UNIX) as abstract,
        ):
            abstract.bind(f"\0{tmp_path}")
            abstract.listen()
            assert await call("connect", f"127.0.0.1:{server.getsockname()[1]}") == "ConnectionRefusedError"
            assert await call("connect", "192.0.2.1:80") == "OSError"
            assert await call("connect", f"\0{tmp_path}") == "ConnectionRefusedError"
            assert await call("connect", f"{tmp_path}/1.sock") == "FileNotFoundError"


async def test_it_sees_no_process_and_no_variable_of_the_daemon(
    sandbox: Sandbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "1234")
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        assert len(await call("processes")) <= 3
        assert "SECRET_TOKEN" not in await call("environment")


@pytest.mark.parametrize(("given", "used"), [(None, "4"), ("16", "16")])
async def test_memory_that_numerical_libraries_reserve_does_not_grow_with_the_machine(
    sandbox: Sandbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str | None, used: str
) -> None:
    """OpenBLAS reserves up to 136 MB for a thread of each processor: the detector failed on 16 with 2 GiB."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if given is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        began_with = [await call("environment_of", process) for process in await call("processes")]
    assert any(f"OPENBLAS_NUM_THREADS={used}" in variables for variables in began_with)


async def test_it_sees_nothing_of_the_daemons_environment_in_any_process(
    sandbox: Sandbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "1234")
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        for process in await call("processes"):
            assert not any("SECRET" in each for each in await call("environment_of", process)), process
        assert set(await call("environment_of", 1)) <= {""}


async def test_it_can_write_nothing_of_the_kernels_and_sees_none_of_its_secrets(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        assert await call("writable", "/proc/sys") == []
        assert [each for each in await call("writable", "/proc") if "/fd/" not in each] == []
        assert await call("writable", "/sys") == []
        for name in ("kcore", "keys", "kmsg", "kallsyms", "sysrq-trigger", "timer_list"):
            assert await call("read", f"/proc/{name}") in ("", "FileNotFoundError", "PermissionError"), name


async def test_it_inherits_what_it_needs_and_nothing_else(sandbox: Sandbox, tmp_path: Path) -> None:
    with (tmp_path / "secret").open("w") as secret:
        os.set_inheritable(secret.fileno(), True)
        async with in_sandbox(sandbox, tmp_path) as (call, _):
            files = [
                each for each in await call("open_files") if not each.startswith(("anon_inode:", "socket:"))
            ]
            assert not [file for file in files if not file.startswith(("pipe:", "/dev/null", "/proc/"))]
            assert (await call("limits")) == [(1, 1), (4096, 4096)]
            assert await call("first_to_be_killed") == 1000


NUMBERS = {  # on x86_64 and on aarch64
    "ptrace": (101, 117),
    "keyctl": (250, 219),
    "add_key": (248, 217),
    "io_uring_setup": (425, 425),
    "userfaultfd": (323, 282),
    "bpf": (321, 280),
    "perf_event_open": (298, 241),
    "unshare": (272, 97),
    "setns": (308, 268),
    "clone3": (435, 435),
    "memfd_create": (319, 279),
    "memfd_secret": (447, 447),
    "shmget": (29, 194),
    "process_vm_readv": (310, 270),
    "syslog": (103, 116),
}
COLUMN = ["x86_64", "aarch64"].index(platform.machine())
CLONE, GETPID = (56, 220)[COLUMN], (39, 172)[COLUMN]
CLONE_NEWUSER = 0x10000000


async def test_it_may_not_ask_the_kernel_for_what_no_service_needs(sandbox: Sandbox, tmp_path: Path) -> None:
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        assert await call("ask_kernel", GETPID, []) == "done"
        for name, numbers in NUMBERS.items():
            arguments = [CLONE_NEWUSER if name == "unshare" else 0] * 6
            assert await call("ask_kernel", numbers[COLUMN], arguments) in ("EPERM", "ENOSYS"), name
        assert await call("ask_kernel", CLONE, [CLONE_NEWUSER | signal.SIGCHLD, 0, 0, 0, 0]) == "EPERM"
        if platform.machine() == "x86_64":  # the numbers of another kind of processor's calls
            assert await call("ask_kernel", 0x40000000 + GETPID, []) == "ENOSYS"


async def test_its_sockets_are_of_families_that_its_network_holds_in(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    stream, raw = int(socket.SOCK_STREAM), int(socket.SOCK_RAW)
    vsock, alg, packet, netlink = 40, 38, 17, 16
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        for named in (socket.AF_UNIX, socket.AF_INET, socket.AF_INET6):
            assert await call("open_socket", int(named), stream, 0, pair=False) == "done"
        assert await call("open_socket", int(socket.AF_UNIX), stream, 0, pair=True) == "done"
        assert await call("open_socket", netlink, raw, 0, pair=False) == "done"
        assert await call("look_up", "127.0.0.1") > 0
        refused = [(vsock, stream, 0), (alg, 5, 0), (packet, raw, 0), (netlink, raw, 9), (30, stream, 0)]
        for family, kind, protocol in refused:
            for pair in (False, True):
                assert await call("open_socket", family, kind, protocol, pair=pair) == "EAFNOSUPPORT", family


async def test_it_gets_no_memory_that_its_limit_does_not_count(sandbox: Sandbox, tmp_path: Path) -> None:
    shared, private, grows_down = mmap.MAP_SHARED, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, 0x100
    async with in_sandbox(sandbox, tmp_path) as (call, _):
        assert await call("map_memory", shared | mmap.MAP_ANONYMOUS, "") == "ENOMEM"
        assert await call("map_memory", private | grows_down, "") == "ENOMEM"
        assert await call("map_memory", private, "") == "ENOMEM", "as much as its limit counts"
        assert await call("map_memory", shared, "/dev/zero") == "ENODEV"


def test_a_processor_of_which_no_calls_are_known_gets_no_sandbox() -> None:
    with pytest.raises(UsageError, match="a processor of the kind mips"):
        call_filter("mips")


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
@pytest.mark.parametrize("shares", [False, True])
def test_a_filter_goes_forward_and_ends_in_an_answer(machine: str, shares: bool) -> None:
    steps = list(struct.iter_unpack("HBBI", call_filter(machine, shares=shares)))
    assert len(steps) < 100
    for place, (operation, if_so, if_not, _) in enumerate(steps):
        if operation & 0x07 == 0x05:
            assert place + 1 + max(if_so, if_not) < len(steps)
    assert steps[-1] == (0x06, 0, 0, 0x7FFF0000)


async def test_a_crash_in_it_is_explained_as_outside(
    sandbox: Sandbox, services: Path, tmp_path: Path
) -> None:
    runtime = ProcessRuntime(
        lambda _: f"unix:{tmp_path}/s.sock",
        max_message_bytes=MAX_MESSAGE_BYTES,
        sandbox=sandbox,
    )
    with pytest.raises(InstanceError, match=r"did not start: .*model.onnx is missing"):
        spec = InstanceSpec("s1", "unstartable", Program(f"{services}:Unstartable"))
        await runtime.start(spec, called=lambda _: None)
    expect_no_child()


@pytest.mark.parametrize(
    ("body", "hidden"),
    [
        ("Path(__file__).with_name('labels.txt').read_text()", "labels.txt"),
        ("from helper import labels", "helper.py"),
    ],
)
async def test_what_lies_beside_a_program_is_named_with_the_key_that_shows_it(
    sandbox: Sandbox, tmp_path: Path, body: str, hidden: str
) -> None:
    (tmp_path / "labels.txt").write_text("person")
    (tmp_path / "helper.py").write_text("labels = []\n")
    program = tmp_path / "hidden_for_tests.py"
    program.write_text(
        "from pathlib import Path\nfrom upwash import service\n@service\nclass Finder:\n"
        f"    def __init__(self) -> None:\n        {body}\n    def find(self) -> int:\n        return 1\n"
    )
    load_service(f"{program}:Finder")  # as a daemon does
    spec = InstanceSpec("s1", "finder", Program(f"{program}:Finder"))

    said = rf"the sandbox hides {tmp_path / hidden}: name what the service needs in runtime\.readable"
    with pytest.raises(InstanceError, match=said):
        await processes(sandbox, tmp_path).start(spec, called=lambda _: None)
    showing = Sandbox(sandbox.bubblewrap, readable=(tmp_path / hidden,))
    await (await processes(showing, tmp_path).start(spec, called=lambda _: None)).stop()


def test_without_bubblewrap_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="apt install bubblewrap"):
        find_sandbox(readable=())


def test_a_bubblewrap_that_is_not_permitted_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = tmp_path / "bwrap"
    refusing.write_text("#!/bin/sh\necho 'bwrap: No permissions to create new namespace' >&2\nexit 1\n")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(UsageError, match=r"No permissions to create new namespace.*user.max_user_namespaces"):
        find_sandbox(readable=())


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("/srv/my_services.py:Counter", ["/srv/my_services.py"]),
        ("upwash.services.hotspots:HotSpotDetector", [str(Path(spec_of.__code__.co_filename).parents[1])]),
        ("no_such_package:Counter", []),
    ],
)
def test_the_code_of_a_program_is_found_without_running_it(program: str, code: list[str]) -> None:
    assert [str(place) for place in code_of(program)] == code


def test_files_are_found_wherever_they_stand_in_settings(tmp_path: Path) -> None:
    model = tmp_path / "model.bin"
    model.touch()
    settings = {
        "model": str(model),
        "spare": [{"at": str(tmp_path)}],
        "gain": 2.0,
        "missing": "/no/such/file",
    }
    assert files_in(settings) == [model, tmp_path]


@pytest.mark.parametrize("ending", [".data", "_data"])
def test_a_model_in_onnx_is_shown_with_its_numbers(ending: str, tmp_path: Path) -> None:
    files = [tmp_path / "model.onnx", tmp_path / f"model.onnx{ending}"]
    for file in (*files, tmp_path / "model.onnx.key", tmp_path / "other.data"):
        file.touch()
    assert files_in({"model": {"onnx": str(files[0])}}) == files
