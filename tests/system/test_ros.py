"""ROS 2: the node and the camera over real rclpy and Fast DDS, seen by a node that knows nothing of upwash."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from tests.children import children, gone
from tests.programs import COUNTING, ROOT, stand_in, write_drone

PYTHON = Path(os.environ.get("UPWASH_ROS_PYTHON", ROOT / ".venv-ros" / "bin" / "python"))
HAS_ROS = any(PYTHON.parents[1].glob("lib/python3*/site-packages/rclpy"))
NO_ROS = "needs ROS 2: make .venv-ros/.ready, with Python 3.11 on x86-64"
STRING, IMAGE = "std_msgs/msg/String", "sensor_msgs/msg/CompressedImage"
TOPIC = "/camera/image/compressed"
RESULT = "/upwash/counter/result"
PATIENCE_S = 60.0  # a node has started on a busy machine
ENVIRONMENT = os.environ | {
    "ROS_DOMAIN_ID": str(os.getpid() % 100 + 1),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}
DRONE = """
name = "heron"
camera.topic = "/camera/image/compressed"
[[service]]
name = "counter"
program = "mission.py:Counter"
local_call_s = 0.5
local_pace_s = 0.5  # whatever the drone's estimates become, the server is sooner
[[server]]
name = "s1"
range_m = "measured"
remote_call_s = 0.05
check_s = 1
check_running_s = 1
"""
ALONE = DRONE.partition("[[server]]")[0]
PLACED = """
ros.position = "/mavros/global_position/global"
mission = { home = { latitude_deg = 39.0, longitude_deg = 22.0 }, waypoints_m = [[0, 0]] }
"""
COUNTER = """
import time
from upwash import service

@service
class Counter:
    def count(self, photo: bytes) -> int:
        if len(photo) == 1000:
            raise ValueError("a thousand bytes")
        time.sleep(0.3 * (len(photo) == 3000))
        return len(photo)
"""

pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group("ros"),
    pytest.mark.skipif(not HAS_ROS, reason=NO_ROS),
]


class Ros:
    """Another node, in a process of its own."""

    node = "upwash"  # whose answers are read

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.line()

    def line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()

    def __call__(self, do: str, **said: Any) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": do, **said}) + "\n")
        self._process.stdin.flush()
        return json.loads(self.line())

    def photo(self, size: int = 5000, **said: Any) -> None:
        header = {"frame_id": "optical", **said.pop("header", {})}
        self(
            "publish",
            topic=TOPIC,
            kind=IMAGE,
            fields={"header": header, "format": "jpeg", "data": size},
            **said,
        )

    def answers(self, text: str, count: int = 1, **said: Any) -> list[dict[str, Any]]:
        topic = f"/{self.node}/counter/result"
        return [
            json.loads(message["data"])
            for message in self("wait", topic=topic, text=text, count=count, **said)
        ]

    def computed(self, size: int) -> dict[str, Any]:
        """The answer to a photo of that size, which is taken again until there is one: a topic loses some."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            self.photo(size)
            if found := self.answers(f":{size}}}", within_s=1.0):  # at its end: a time may have those digits
                return found[0]
        raise AssertionError(f"no photo of {size} bytes was computed")

    def status(self, name: str, text: str) -> dict[str, Any]:
        """The diagnostics of that name, once their message has the text."""
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            self("forget", topic="/diagnostics")
            for array in self("wait", topic="/diagnostics", text=f'"upwash: {name}"', within_s=3.0):
                for status in array["status"]:
                    if status["name"] == f"upwash: {name}" and text in status["message"]:
                        return dict(status)
        raise AssertionError(f"no diagnostics of {name} had {text!r}")


@contextlib.contextmanager
def running(*command: object, folder: Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [str(PYTHON), *map(str, command)],
        cwd=folder,
        env=ENVIRONMENT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)  # others know nodes that were killed for 20 s
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()


@contextlib.contextmanager
def another_node(
    ros: Ros, name: str, folder: Path, config: str = ALONE, *, topic: str = TOPIC, managed: bool = False
) -> Iterator[None]:
    """A node, without servers by default, whose answers are read in the block."""
    (folder / "mission.py").write_text(COUNTER)
    (folder / "drone.toml").write_text(config)
    ros("listen", topic=f"/{name}/counter/result", kind=STRING)
    words = ("ros", "--config", "drone.toml", *(["--managed"] if managed else []))
    names = ("--ros-args", "-r", f"__node:={name}", "-r", f"{TOPIC}:={topic}")
    ros.node = name
    try:
        with running("-m", "upwash", *words, *names, folder=folder):
            yield
    finally:
        ros.node = Ros.node


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    with running(
        ROOT / "tests" / "system" / "ros" / "peer.py", folder=tmp_path_factory.mktemp("peer")
    ) as process:
        peer = Ros(process)
        for topic, kind in ((RESULT, STRING), ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")):
            peer("listen", topic=topic, kind=kind)
        yield peer


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    folder = tmp_path_factory.mktemp("server")
    (folder / "mission.py").write_text(COUNTER)
    tables = {"name": "counter", "program": "mission.py:Counter"}
    document = {"listen": "127.0.0.1:0", "allow_without_certificates": True, "runtime": {"sandbox": "off"}}
    (folder / "server.toml").write_text(
        tomli_w.dumps(document | {"service": [tables], "server": [{"name": "s1"}]})
    )
    with running("-m", "upwash", "serve", "--config", "server.toml", folder=folder) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1], process


@pytest.fixture(scope="module")
def node(
    tmp_path_factory: pytest.TempPathFactory, server: tuple[str, subprocess.Popen[str]], ros: Ros
) -> Iterator[subprocess.Popen[str]]:
    folder = tmp_path_factory.mktemp("node")
    (folder / "mission.py").write_text(COUNTER)
    (folder / "drone.toml").write_text(DRONE + f'address = "{server[0]}"\n')
    ros("listen", topic="/upwash/servers", kind=STRING, latched=True)
    with running("-m", "upwash", "ros", "--config", "drone.toml", folder=folder) as process:
        assert ros("wait", topic="/upwash/servers", text="READY")  # a server was selected
        ros.computed(4000)  # a new publisher loses photos until the subscriber knows it too
        yield process


@pytest.mark.usefixtures("node")
def test_the_node_shows_topics_services_and_parameters_as_ros_users_expect(ros: Ros) -> None:
    graph = ros("graph")
    assert "upwash" in graph["nodes"]
    assert (
        graph["topics"]
        | {
            TOPIC: [IMAGE],
            RESULT: [STRING],
            "/upwash/events": [STRING],
            "/upwash/servers": [STRING],
            "/upwash/transition_event": ["lifecycle_msgs/msg/TransitionEvent"],
            "/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"],
        }
        == graph["topics"]
    )
    assert graph["services"]["/upwash/counter"] == ["std_srvs/srv/Trigger"]
    assert graph["services"]["/upwash/change_state"] == ["lifecycle_msgs/srv/ChangeState"]
    assert (
        ros("call", service="/upwash/get_state", kind="lifecycle_msgs/srv/GetState")["current_state"]["label"]
        == "active"
    )
    names = ["policy.name", "service.counter.local_call_s"]
    listed = ros("call", service="/upwash/list_parameters", kind="rcl_interfaces/srv/ListParameters")
    assert set(names) <= set(listed["result"]["names"]), listed
    get = "rcl_interfaces/srv/GetParameters"
    values = ros("call", service="/upwash/get_parameters", kind=get, fields={"names": names})["values"]
    assert (values[0]["string_value"], values[1]["double_value"]) == ("look-ahead", 0.5)


@pytest.mark.usefixtures("node")
def test_a_photo_is_computed_at_the_server_and_keeps_its_stamp_and_frame(ros: Ros) -> None:
    ros.photo(4001, header={"stamp": {"sec": 1_900_000_000, "nanosec": 7}})
    (answer,) = ros.answers(":4001}")
    assert answer["stamp"] == {"sec": 1_900_000_000, "nanosec": 7}
    assert (answer["frame_id"], answer["place"], answer["result"]) == ("optical", "s1", 4001)
    reply = ros("call", service="/upwash/counter", kind="std_srvs/srv/Trigger")
    assert reply["success"] and json.loads(reply["message"])["result"] == 4001


@pytest.mark.usefixtures("node")
def test_the_newest_photo_is_computed_next_and_older_ones_are_dropped(ros: Ros) -> None:
    ros("forget", topic=RESULT)
    ros.photo(3000)
    for size in range(3001, 3011):
        ros.photo(size)
    assert ros.answers(":3010}")
    sizes = [answer["result"] for answer in ros.answers("result", 0)]
    assert len(sizes) < 11 and sizes[-1] == 3010
    values = {value["key"]: value["value"] for value in ros.status("counter", "OK")["values"]}
    assert 1 <= int(values["dropped"]) <= 11 - len(sizes)  # DDS has replaced some, too


@pytest.mark.usefixtures("node")
def test_what_does_not_fit_is_a_diagnostic_and_the_next_photo_is_computed(ros: Ros) -> None:
    ros.photo(1000)  # the service raises
    assert "ValueError: a thousand bytes" in ros.status("counter", "a thousand bytes")["message"]
    assert ros.answers("a thousand bytes")[0]["error"]
    ros("publish", topic=TOPIC, kind=IMAGE, fields={"format": "h264", "data": [0, 0, 0, 1]})
    assert "not a JPEG or PNG" in ros.status("counter", "h264")["message"]
    ros("listen", topic=RESULT, kind=STRING, latched=True)  # which results are not
    assert "quality of service" in ros.status("subscribers", "~/counter/result")["message"]
    ros.photo(4002, header={"stamp": {"sec": 1000, "nanosec": 0}})
    photos = ros.status("photos", "went back")
    assert (
        photos["level"] == 1
        and "says 1970-01-01 00:16:40 UTC where this computer's says" in photos["message"]
    )
    assert ros.answers(":4002}")[0]["stamp"]["sec"] == 1000


def test_a_server_is_used_where_mavros_says_that_the_drone_is_in_its_range(
    ros: Ros, server: tuple[str, subprocess.Popen[str]], tmp_path: Path
) -> None:
    ranged = DRONE.replace('range_m = "measured"', "east_m = 0\nnorth_m = 0\nrange_m = 100")
    fix = {"topic": "/mavros/global_position/global", "kind": "sensor_msgs/msg/NavSatFix"}

    def computed_at(latitude_deg: float, place: str) -> bool:
        for _ in range(20):
            place_there = {"latitude": latitude_deg, "longitude": 22.0, "altitude": 5.0}
            ros("publish", **fix, fields={"status": {"status": 0}, **place_there})
            if ros.computed(4400)["place"] == place:
                return True
            ros("forget", topic="/placed/counter/result")
            time.sleep(0.3)  # a check takes a while
        return False

    config = PLACED + ranged + f'address = "{server[0]}"\n'
    with another_node(ros, "placed", tmp_path, config):
        assert computed_at(39.01, "local")  # 1.1 km away
        assert computed_at(39.0001, "s1")
        ros("publish", **fix, fields={"status": {"status": 0}, "latitude": 1e9}, times=3)
        assert "no place on the Earth" in ros.status("position", "Earth")["message"]


def test_photos_go_on_at_the_drone_when_the_server_is_killed(
    ros: Ros, node: subprocess.Popen[str], server: tuple[str, subprocess.Popen[str]]
) -> None:
    instances = children(server[1].pid)
    server[1].kill()
    assert gone(*instances)  # they answer until they notice that their program was killed
    ros("forget", topic=RESULT)
    for size in range(4100, 4104):
        answer = ros.computed(size)
        assert answer["place"] == "local" and "error" not in answer, answer
    assert ros.status("s1", "")["level"] == 1
    node.send_signal(signal.SIGINT)
    assert node.wait(20) == 0


def test_a_lifecycle_manager_activates_a_managed_node(tmp_path: Path, ros: Ros) -> None:
    def change(transition: int) -> bool:
        kind, fields = "lifecycle_msgs/srv/ChangeState", {"transition": {"id": transition}}
        return bool(ros("call", service="/managed/change_state", kind=kind, fields=fields)["success"])

    with another_node(ros, "managed", tmp_path, managed=True):
        assert change(1)  # configure
        reply = ros("call", service="/managed/counter", kind="std_srvs/srv/Trigger")
        assert (reply["success"], reply["message"]) == (False, "the node is not active")
        assert change(3)  # activate
        assert ros.computed(4200)["place"] == "local"
        assert change(4)  # deactivate
        assert change(3)
        assert ros.computed(4201)


def test_raw_images_are_computed_and_an_unknown_encoding_is_named(tmp_path: Path, ros: Ros) -> None:
    image = {"height": 2, "width": 2, "step": 6, "encoding": "rgb8", "data": [0] * 12}
    raw = {"topic": "/camera/raw", "kind": "sensor_msgs/msg/Image"}
    with another_node(ros, "raw", tmp_path, topic="/camera/raw"):
        ros("publish", **raw, fields=image, times=5, every_s=0.3)
        assert ros.answers("result")[0]["result"] > 100  # of a JPEG
        for changed, said in (({"encoding": "rainbow"}, "'rainbow'"), ({"height": 3}, "12 bytes")):
            ros("publish", **raw, fields=image | changed)
            assert said in ros.status("counter", said)["message"]


def test_a_topic_of_another_type_is_named(tmp_path: Path, ros: Ros) -> None:
    with another_node(ros, "text", tmp_path, topic="/camera/text"):
        ros("publish", topic="/camera/text", kind=STRING, fields={}, times=0)
        assert "carries std_msgs/msg/String" in ros.status("photos", "carries")["message"]


def test_a_flight_takes_its_photos_from_a_topic_and_tells_other_nodes_of_it(tmp_path: Path, ros: Ros) -> None:
    write_drone(
        tmp_path,
        COUNTING.replace("end_flight", "autopilot.land"),
        mission={"altitude_m": 2.0},
        service=[{"name": "counter", "program": "mission.py:Counter", "local_call_s": 1.0}],
    )
    config = (tmp_path / "drone.toml").read_text().replace('folder = "photos"', f'topic = "{TOPIC}"')
    (tmp_path / "drone.toml").write_text(config)
    ros("listen", topic="/upwash/events", kind=STRING)
    with (
        stand_in(tmp_path, "--acceleration", "50") as vehicle,
        running(
            "-m", "upwash", "fly", "--config", "drone.toml", "--autopilot", vehicle, folder=tmp_path
        ) as flight,
    ):
        until_s = time.monotonic() + PATIENCE_S
        while flight.poll() is None and time.monotonic() < until_s:
            ros.photo(4300, times=5, every_s=0.1)
        assert flight.poll() == 0
    (told,) = ros("wait", topic="/upwash/events", text="notified")
    assert json.loads(told["data"])["message"] == 4300


def test_without_ros_the_command_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "drone.toml").write_text(ALONE)
    (tmp_path / "mission.py").write_text(COUNTER)
    hidden = "import sys; sys.modules['rclpy'] = None; from upwash.cli.main import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", hidden, "ros", "--config", "drone.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("upwash: ROS 2 cannot be imported") and "setup.bash" in done.stderr
    assert done.stderr.count("\n") == 1
