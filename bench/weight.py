"""What a drone's programs weigh in memory while they fly, beside a bare gRPC client and an HTTP client.

Run from the repository, on Linux: `python -m bench.weight`. A quiet flight with a service of its own calls it at each
waypoint; a second flight has certificates and a daemon near. `--against DIR` flies another checkout's programs in
the same rounds. Afterwards each module that the drone's two programs import is weighed by itself.

`/proc/PID/smaps` says what each process holds. A *proportional* part of a page of a file is counted, as a page in use
by several processes has its share in each; on a machine with many Python programs that part is small. *Alone* is what
the same processes take where nothing else runs: their own pages, and each page of a file once.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from statistics import median

import grpc
import msgspec
from bench.call import running
from bench.echo import answer
from bench.program import command_line
from bench.results import FOLDER, leave
from bench.servers import GRPC_PATH
from tests.children import children

from upwash.real.trust.authority import make_keys

ROOT = Path(__file__).parents[1]
CALLS = 6  # before it is weighed: the first ones still load what they need
LONGEST_S = 60.0
HEAVIEST = 12
MISSION = """
def shuttle(drone):
    from bench.echo import Echo
    echo = drone.service(Echo)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    while True:
        for waypoint in drone.plan:
            echo.measure(drone.camera.take_photo())
            drone.autopilot.goto(waypoint)
"""
DRONE = """
name = "drone"
mission.home = {{ latitude_deg = 39.3666, longitude_deg = 22.9507 }}
mission.altitude_m = 5.0
mission.waypoints_m = [[0, 0], [4, 0]]
autopilot.connection = "{connection}"
camera.folder = "photos"
network.kind = "wired"
[[service]]
name = "echo"
program = "bench.echo:Echo"
local_call_s = {{ "" = 1.0 }}
"""
SERVER = """
[keys]
authority = "authority.pem"
certificate = "drone.pem"
key = "drone.key"
[[server]]
name = "s1"
east_m = 0.0
north_m = 0.0
range_m = 1000.0
network = "wired"
address = "{address}"
remote_call_s.echo = {{ "" = 0.01 }}
"""
DAEMON = """
listen = "127.0.0.1:0"
runtime.sandbox = "off"
runtime.sandbox_as_root = true
keys = { authority = "authority.pem", certificate = "s1.pem", key = "s1.key" }
[[service]]
name = "echo"
program = "bench.echo:Echo"
[[server]]
name = "s1"
"""
GRPC_CLIENT = f"""
import sys, grpc
with grpc.insecure_channel(sys.argv[1]) as channel:
    channel.unary_unary({GRPC_PATH!r})(bytes(430_000), timeout=10)
    print("called", flush=True)
    sys.stdin.read()
"""
HTTP_CLIENT = """
import sys, http.client
connection = http.client.HTTPConnection(sys.argv[1], timeout=10)
connection.request("POST", "/", bytes(430_000))
connection.getresponse().read()
print("called", flush=True)
sys.stdin.read()
"""
PROGRAMS = {  # their imports for every flight, without parts that only some flights need
    "upwash fly": "upwash.cli.main upwash.cli.fly",
    "its service": "upwash.real.instances.instance",
}


class Extent(msgspec.Struct, frozen=True):
    """How much is measured."""

    calls: int  # of each flight, before it is weighed
    with_server: Sequence[bool]  # a flight for each, in each round
    programs: Sequence[str]  # whose modules are weighed


FULL = Extent(CALLS, (False, True), tuple(PROGRAMS))
QUICK = Extent(1, (False,), ("its service",))


class Weight(msgspec.Struct, frozen=True):
    """What processes hold together, in MB."""

    proportional_mb: float
    own_mb: float  # pages that are of no file, or were changed
    alone_mb: float


class Line(msgspec.Struct, frozen=True):
    """One contender's medians."""

    what: str
    weight: Weight
    ratio_to_grpc: float  # of what they take alone, the median of the rounds' ratios
    ratio_to_http: float


# --- weighing -----------------------------------------------------------------------------------------------


def weigh(*processes: int) -> Weight:
    """What the processes hold together."""
    proportional = own = 0
    files: dict[str, int] = {}
    for process in processes:
        here: Counter[str] = Counter()
        for head, kept in _mappings(process):
            proportional += kept["Pss"]
            own += kept["Anonymous"]
            here[head] += kept["Rss"] - kept["Anonymous"]
        for head, kilobytes in here.items():  # nearly the same pages of it are in use by all
            files[head] = max(files.get(head, 0), kilobytes)
    return Weight(*(each * 1024 / 1e6 for each in (proportional, own, own + sum(files.values()))))


def _mappings(process: int) -> Iterator[tuple[str, Mapping[str, int]]]:
    """What is mapped where, as file and place in it, with its kilobytes by kind."""
    head, kept = "", dict[str, int]()
    for line in Path(f"/proc/{process}/smaps").read_text().splitlines():
        if field := re.match(r"(\w+): +(\d+) kB", line):
            kept[field[1]] = int(field[2])
        elif mapping := re.match(r"[0-9a-f]+-[0-9a-f]+ \S+ (?P<at>\S+) \S+ \d+ *(?P<file>.*)", line):
            if kept:
                yield head, kept
            head, kept = f"{mapping['file']}@{mapping['at']}", {}
    yield head, kept


# --- the contenders -----------------------------------------------------------------------------------------


@contextlib.contextmanager
def flying(
    folder: Path, checkout: Path, *, with_server: bool, calls: int = CALLS
) -> Iterator[tuple[int, int]]:
    """The processes of a drone that flies and has called its service: the program's, and its own service's."""
    upwash = (sys.executable, "-m", "upwash")
    paths = os.pathsep.join(str(each) for each in (checkout / "src", ROOT))
    environment = {**os.environ, "PYTHONPATH": paths}
    (folder / "photos").mkdir(exist_ok=True)
    (folder / "photos" / "1.jpg").write_bytes(bytes(430_000))
    (folder / "mission.py").write_text(MISSION)
    (folder / "daemon.toml").write_text(DAEMON)
    log, said = folder / "events.jsonl", folder / "said"
    log.unlink(missing_ok=True)
    with contextlib.ExitStack() as stack:
        vehicle = (*upwash, "vehicle", "--listen", "tcp:127.0.0.1:0", "--armable-after", "0")
        config = DRONE.format(connection=stack.enter_context(running(vehicle, log=said)))
        if with_server:
            daemon = (*upwash, "serve", "--config", str(folder / "daemon.toml"))
            config += SERVER.format(address=stack.enter_context(running(daemon, log=said)))
        (folder / "drone.toml").write_text(config)
        fly = (*upwash, "fly", "mission.py:shuttle", "--config", "drone.toml", "--quiet", "--log", str(log))
        with said.open("a") as output:
            program = stack.enter_context(
                subprocess.Popen(fly, cwd=folder, env=environment, stdout=output, stderr=output)
            )
        stack.callback(program.kill)  # its service ends with it
        _wait_for_calls(program, log, said, calls, place="s1" if with_server else "local")
        yield program.pid, next(child for child in children(program.pid) if _is_service(child))


def _is_service(process_id: int) -> bool:
    return b"upwash.real.instances.instance" in Path(f"/proc/{process_id}/cmdline").read_bytes()


def _wait_for_calls(
    program: subprocess.Popen[bytes], log: Path, said: Path, calls: int, *, place: str
) -> None:
    give_up_s = time.monotonic() + LONGEST_S
    while True:
        lines = log.read_bytes().split(b"\n")[:-1] if log.exists() else []  # the last may not be whole yet
        events = [msgspec.json.decode(line) for line in lines]
        places = [event["place"] for event in events if event["event"] == "call"]
        if len(places) >= calls and places[-1] == place:
            return
        if program.poll() is not None or time.monotonic() > give_up_s:
            raise SystemExit(f"the drone made no {calls} calls:\n{said.read_text()}")
        time.sleep(0.1)


@contextlib.contextmanager
def client(code: str, address: str) -> Iterator[int]:
    """The process of a client that has made its call."""
    command = (sys.executable, "-c", code, address)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        if process.stdout.readline() != b"called\n":
            raise SystemExit("a client made no call")
        yield process.pid


@contextlib.contextmanager
def echoing() -> Iterator[tuple[str, str]]:
    """The addresses of a gRPC server and of an HTTP server in this process, for the clients."""
    service, _, method = GRPC_PATH[1:].partition("/")
    handler = grpc.unary_unary_rpc_method_handler(lambda body, _: answer(body))
    server = grpc.server(ThreadPoolExecutor(1))
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(service, {method: handler}),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    with HTTPServer(("127.0.0.1", 0), _Echo) as http:
        threading.Thread(target=http.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{port}", f"127.0.0.1:{http.server_port}"
        http.shutdown()
    server.stop(None)


class _Echo(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        """Answers as the others do."""
        reply = answer(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(200)
        self.send_header("Content-Length", str(len(reply)))
        self.end_headers()
        self.wfile.write(reply)

    def log_message(self, *_: object) -> None:
        """Says nothing."""


def round_of(
    folder: Path, checkouts: Mapping[str, Path], addresses: tuple[str, str], extent: Extent
) -> dict[str, Weight]:
    """Every contender, one after the other; each flight is with a server or without one."""
    found = {}
    for what, code, address in zip(
        ("gRPC client", "HTTP client"), (GRPC_CLIENT, HTTP_CLIENT), addresses, strict=True
    ):
        with client(code, address) as process:
            found[what] = weigh(process)
    for with_server in extent.with_server:
        where = "with a server" if with_server else "on its own"
        for title, checkout in checkouts.items():
            with flying(folder, checkout, with_server=with_server, calls=extent.calls) as (program, service):
                found[f"drone {where}{title}"] = weigh(program, service)
                found[f"— its program{title}, {where}"] = weigh(program)
                found[f"— its service{title}, {where}"] = weigh(service)
    return found


def summary(rounds: Sequence[Mapping[str, Weight]]) -> list[Line]:
    """The medians of each contender."""

    def ratio(what: str, to: str) -> float:
        return round(median(each[what].alone_mb / each[to].alone_mb for each in rounds), 2)

    def middle(what: str) -> Weight:
        fields = Weight.__struct_fields__
        return Weight(*(round(median(getattr(each[what], name) for each in rounds), 1) for name in fields))

    return [
        Line(what, middle(what), ratio(what, "gRPC client"), ratio(what, "HTTP client")) for what in rounds[0]
    ]


# --- what the modules weigh ---------------------------------------------------------------------------------

WEIGH_MODULES = """
import sys, tracemalloc

class Scale:
    'Weighs what the import of each module leaves behind, without that of the modules that it imports.'
    def __init__(self):
        self.within, self.found = [], {}
    def find_spec(self, name, path=None, target=None):
        for finder in sys.meta_path[1:]:
            spec = finder.find_spec(name, path, target)
            if spec is not None:
                if spec.loader is not None and hasattr(spec.loader, 'exec_module'):
                    self.weigh(spec.loader, name)
                return spec
    def weigh(self, loader, name):
        run = loader.exec_module
        def weighed(module):
            before, within = tracemalloc.get_traced_memory()[0], len(self.within)
            self.within.append(0)
            try:
                run(module)
            finally:
                step = tracemalloc.get_traced_memory()[0] - before
                self.found[name] = step - self.within.pop()
                if self.within:
                    self.within[-1] += step
        loader.exec_module = weighed

tracemalloc.start(1)
scale = Scale()
sys.meta_path.insert(0, scale)
import importlib
for name in sys.argv[1:]:
    importlib.import_module(name)
for name, size in scale.found.items():
    print(name, size)
"""


def module_weights(modules: str, checkout: Path) -> dict[str, float]:
    """What the import of each module leaves on Python's heap, in MB."""
    told = subprocess.run(
        (sys.executable, "-c", WEIGH_MODULES, *modules.split()),
        env={**os.environ, "PYTHONPATH": str(checkout / "src")},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    return {name: int(size) / 1e6 for name, size in map(str.split, told.splitlines())}


def show_modules(checkout: Path, programs: Sequence[str]) -> None:
    """Prints which modules and packages of the programs are the heaviest."""
    for title in programs:
        weights = module_weights(PROGRAMS[title], checkout)
        packages = defaultdict[str, float](float)
        for name, megabytes in weights.items():
            packages[name.partition(".")[0]] += megabytes
        print(f"\n{title} imports {len(weights)} modules: {sum(weights.values()):.1f} MB on Python's heap")
        print("  packages: " + _largest(packages))
        print("  modules by themselves: " + _largest(weights))


def _largest(weights: Mapping[str, float]) -> str:
    heaviest = sorted(weights.items(), key=lambda each: -each[1])[:HEAVIEST]
    return ", ".join(f"{name} {megabytes:.2f}" for name, megabytes in heaviest)


def main() -> None:
    """Measures and prints."""
    parser = command_line("weight", __doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--against", type=Path, metavar="DIR", help="fly this checkout's programs too")
    parser.add_argument("--keep", action="store_true", help="leave the figures in bench/results/weight.json")
    options = parser.parse_args()
    if options.quick and options.keep:
        parser.error("figures of a quick run mean nothing, and are not kept")
    if not Path("/proc/self/smaps").exists():
        print("no /proc/PID/smaps here: not measured")
        return
    extent, count = (QUICK, 1) if options.quick else (FULL, options.rounds)
    checkouts = {"": ROOT}
    if options.against:
        checkouts = {" before": options.against.resolve(), "": ROOT}
    with tempfile.TemporaryDirectory(prefix="upwash-weight-") as name, echoing() as addresses:
        make_keys(Path(name), servers=[["s1"]], drones=["drone"])
        rounds = [round_of(Path(name), checkouts, addresses, extent) for _ in range(count)]
    lines = summary(rounds)
    print(f"{'MB, medians of ' + str(count):40} {'proportional':>13} {'own':>6} {'alone':>6}", end="")
    print("   alone / gRPC client, / HTTP client")
    for line in lines:
        weight = line.weight
        print(
            f"{line.what:40} {weight.proportional_mb:13.1f} {weight.own_mb:6.1f} {weight.alone_mb:6.1f}"
            f" {line.ratio_to_grpc:15.2f} {line.ratio_to_http:15.2f}"
        )
    for checkout in checkouts.values():
        show_modules(checkout, extent.programs)
    if options.keep:
        command = f"python -m bench.weight --rounds {count}" + " --against DIR" * bool(options.against)
        leave(FOLDER / "weight.json", command=f"{command} --keep", figures=lines)


if __name__ == "__main__":
    main()
