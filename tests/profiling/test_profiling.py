"""Profiling on virtual time: a made-up service, links that carry so many bytes a second."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, TypeVar

import msgspec
import pytest

from upwash.config.reading import read_document
from upwash.drone.networks import NoNetwork
from upwash.drone.server_session import ServerEndpoint
from upwash.errors import InstanceError, LinkError, Refused, Unreachable, UsageError
from upwash.ports import InstanceSpec, Program
from upwash.profiling.profiler import (
    CallSample,
    calls_to_make,
    profile_onboard,
    profile_server,
    samples,
    values_of,
)
from upwash.profiling.report import chosen_setting, server_table, service_table
from upwash.rpc.protocol import AVAILABILITY, LEAVE, START, AvailabilityReply, LeaveReply, StartReply
from upwash.rpc.service import service, spec_of
from upwash.sim.loop import run_virtually

T = TypeVar("T")
START_S, FIRST_S, CALL_S, LATENCY_S, BYTES_PER_S = 4.0, 1.5, {"light": 0.25, "heavy": 2.0}, 0.01, 1e6
PHOTOS = {"a.jpg": b"p" * 100_000, "b.jpg": b"p" * 300_000}
START_TIMEOUT_S = 10.0


class Size(Enum):
    SMALL = "small"
    LARGE = "large"


@service(profile_by="mode")
class Viewer:
    def view(self, photo: bytes, mode: Literal["light", "heavy"], limit: int = 3) -> list[int]:
        return [limit]

    def compare(self, first: bytes, second: bytes) -> bool:
        return first == second

    def fetch(self, name: str) -> bytes:
        return name.encode()


@service(profile_by="size")
class Resizer:
    def resize(self, photo: bytes, *, size: Size) -> bytes:
        return photo[: 10 if size is Size.SMALL else 20]


@service
class Picky:
    def look(self, photo: bytes) -> int:
        raise ValueError("not such a photo")


@service(profile_by="width")
class Unbounded:
    def look(self, photo: bytes, width: int) -> int:
        return width


@service
class Talker:
    def say(self, text: str) -> str:
        return text


VIEWER = samples(spec_of(Viewer), PHOTOS)


@dataclass
class Computer:
    """Runs instances: the first call of each is slow, and so is the way there."""

    cls: type = Viewer
    bytes_per_s: float = BYTES_PER_S
    running: bool = False
    warm: bool = False
    starts: int = 0
    stops: int = 0
    paths: list[str] = field(default_factory=list)

    async def start(self, spec: InstanceSpec, *, called: Callable[[str], None], **_: Any) -> Computer:
        await asyncio.sleep(START_S)
        self.running, self.warm = True, False
        self.starts += 1
        return self

    @property
    def endpoint(self) -> str:
        return "here"

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        pass

    async def drain(self, why: str) -> None:
        pass

    async def health(self) -> None:
        pass

    async def exited(self) -> str:
        await asyncio.get_running_loop().create_future()
        return ""

    async def stop(self) -> None:
        self.running = False
        self.stops += 1

    def dial(self, address: str, *, server: str) -> Computer:
        return self

    async def close(self) -> None:
        pass

    is_far = False

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        self.paths.append(path)
        await asyncio.sleep(LATENCY_S + len(body) / self.bytes_per_s)
        if path == AVAILABILITY:
            endpoints = {"viewer": ":1"} if self.running else {}
            return msgspec.msgpack.encode(
                AvailabilityReply(available=True, endpoints=endpoints, lease_s=30.0)
            )
        if path == START:
            await self.start(InstanceSpec("s1", "viewer", Program("x:Viewer")), called=lambda _: None)
            return msgspec.msgpack.encode(StartReply(endpoint=":1"))
        if path == LEAVE:
            return msgspec.msgpack.encode(LeaveReply())
        method = spec_of(self.cls).methods[path.rpartition("/")[2]]
        key, reply = method.perform(self.cls(), body)
        if key:
            await asyncio.sleep(CALL_S.get(key, 0.0) + (0.0 if self.warm else FIRST_S))
            self.warm = True
        return reply


def virtually(profile: Coroutine[Any, Any, T]) -> T:
    return run_virtually(profile)


def onboard(
    computer: Computer, found: list[CallSample], watch: Callable[[str], None] = lambda _: None
) -> Any:
    return virtually(
        profile_onboard(
            InstanceSpec("profiler", found[0].operation.service, Program("x:Y")),
            found,
            calls=4,
            drone="profiler",
            start_timeout_s=START_TIMEOUT_S,
            runtime=computer,
            dialer=computer,
            memory_bytes=lambda: 7_000_000,
            watch=watch,
        )
    )


def at_server(computer: Computer) -> Any:
    endpoint = ServerEndpoint("s1", "net", "s1:7070", ("viewer",))
    return virtually(
        profile_server(
            endpoint,
            VIEWER,
            calls=4,
            start_timeout_s=START_TIMEOUT_S,
            network=NoNetwork(),
            dialer=computer,
            watch=lambda _: None,
        )
    )


def test_every_method_that_takes_one_photo_is_an_operation_for_each_profile_key() -> None:
    assert sorted(str(sample.operation) for sample in VIEWER) == ["viewer.view[heavy]", "viewer.view[light]"]
    assert {str(each.operation) for each in samples(spec_of(Resizer), PHOTOS)} == {
        "resizer.resize[small]",
        "resizer.resize[large]",
    }


@pytest.mark.parametrize(
    ("cls", "said"), [(Talker, "no method that takes one photo"), (Unbounded, "Literal or an Enum")]
)
def test_a_service_that_cannot_be_called_with_photos_alone_is_refused(cls: type, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        samples(spec_of(cls), PHOTOS)


def test_on_the_drone_the_start_the_first_call_and_those_after_it_are_told_apart() -> None:
    watched: list[str] = []
    computer = Computer()
    profile = onboard(computer, VIEWER, watched.append)
    carried_s = LATENCY_S + 0.2  # the mean photo
    by_key = {call.sample.operation.key: call for call in profile.calls}
    for key, call_s in CALL_S.items():
        assert by_key[key].mean_s == pytest.approx(call_s + carried_s, rel=1e-3)
        assert by_key[key].first_s == pytest.approx(call_s + FIRST_S + LATENCY_S + 0.1, rel=1e-3)
    assert profile.start_s == (START_S, START_S)
    assert computer.stops == computer.starts == len(VIEWER)
    assert len(watched) == calls_to_make(VIEWER, 4)


def test_a_service_that_starts_too_slowly_ends_the_profiling_with_the_key_that_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tests.profiling.test_profiling.START_S", START_TIMEOUT_S + 1)
    with pytest.raises(
        InstanceError, match=r"within 10 s: raise start_timeout_s in the drone's configuration"
    ):
        onboard(Computer(), VIEWER)


def test_a_photo_that_the_service_refuses_ends_the_profiling_and_the_instance() -> None:
    computer = Computer(cls=Picky)
    with pytest.raises(UsageError, match=r"picky\.look failed on a\.jpg: ValueError: not such a photo"):
        onboard(computer, samples(spec_of(Picky), PHOTOS))
    assert not computer.running


def test_at_a_server_processing_and_the_way_there_are_told_apart() -> None:
    profile = at_server(Computer())
    assert profile.check_s == pytest.approx(START_S + 2 * LATENCY_S, rel=0.01)
    assert profile.check_running_s == pytest.approx(LATENCY_S, rel=0.01)
    assert profile.goodput_bit_s == pytest.approx(8 * BYTES_PER_S, rel=0.01)
    by_key = {operation.key: processing_s for operation, processing_s in profile.processing_s.items()}
    assert by_key == {key: pytest.approx(call_s, abs=0.01) for key, call_s in CALL_S.items()}


def test_services_that_run_already_leave_the_cold_check_unmeasured() -> None:
    profile = at_server(Computer(running=True))
    assert profile.check_s is None
    assert "not measured" in server_table(profile, server="s1", computer="a desk")


def test_a_way_too_fast_to_measure_is_said_to_be_so() -> None:
    profile = at_server(Computer(bytes_per_s=1e12))
    assert profile.goodput_bit_s is None
    text = server_table(profile, server="s1", computer="a desk")
    assert "bandwidth_bit_s" not in text
    assert "remote_call_s" in text


class Dead(Computer):
    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        raise Unreachable("s1 does not answer")


class Full(Computer):
    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        return msgspec.msgpack.encode(AvailabilityReply(available=False, reason="no slot is free"))


@pytest.mark.parametrize(("computer", "error"), [(Dead(), Unreachable), (Full(), Refused)])
def test_a_server_that_cannot_be_used_says_why(computer: Computer, error: type[LinkError]) -> None:
    with pytest.raises(error, match="s1"):
        at_server(computer)


def test_what_is_written_is_read_as_a_configuration(tmp_path: Any) -> None:
    service_text = service_table(onboard(Computer(), VIEWER), program="/a/b.py:Viewer", computer="a desk")
    server_text = server_table(at_server(Computer()), server="s1", computer="a desk")
    file = tmp_path / "drone.toml"
    file.write_text(service_text + "\n[[server]]\n" + server_text)
    document = read_document(file)
    (table,), (server,) = document["service"], document["server"]
    assert table["program"] == "/a/b.py:Viewer"
    assert table["local_call_s"] == {
        "light": pytest.approx(0.46, abs=0.01),
        "heavy": pytest.approx(2.21, abs=0.01),
    }
    assert table["local_first_extra_s"] == pytest.approx(FIRST_S - 0.1, abs=0.01)
    assert table["request_bytes"] == pytest.approx(200_000, rel=0.01)
    assert server["processing_s"]["viewer"]["heavy"] == pytest.approx(2.0, abs=0.01)
    assert server["bandwidth_bit_s"] == pytest.approx(8e6, rel=0.01)


@service
class Configured:
    def __init__(self, *, engine: Literal["one", "two"] = "one", level: int = 1) -> None:
        self.engine, self.level = engine, level

    def look(self, photo: bytes) -> int:
        return self.level


def test_the_values_of_a_setting_are_those_of_its_literal() -> None:
    assert values_of(spec_of(Configured), "engine") == ("one", "two")
    with pytest.raises(
        UsageError, match="setting level of service 'configured' can be more than a few words"
    ):
        values_of(spec_of(Configured), "level")
    with pytest.raises(UsageError, match="no setting 'speed'; it has engine, level"):
        values_of(spec_of(Configured), "speed")


def test_the_fastest_value_of_a_setting_is_written_with_what_the_others_took(tmp_path: Any) -> None:
    profiles = {
        "one": onboard(Computer(), VIEWER),
        "two": onboard(Computer(bytes_per_s=10 * BYTES_PER_S), VIEWER),
    }
    text = service_table(profiles["two"], program=None, computer="a desk") + chosen_setting(
        "engine", profiles
    )
    file = tmp_path / "drone.toml"
    file.write_text(text)
    (table,) = read_document(file)["service"]
    assert table["settings"] == {"engine": "two"}
    assert "# one: heavy 2.210 s, light 0.460 s\n" in text
    assert "# two: heavy 2.030 s, light 0.280 s\n" in text
