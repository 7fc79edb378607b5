"""The programs of bench/ that need root, with as little to do as they can be told to have."""

from __future__ import annotations

import os
import re
import shutil

import pytest
from tests.engines import OwnEngine
from tests.podman import OwnPodman
from tests.programs import printed
from tests.system.test_ros import HAS_ROS, NO_ROS, PYTHON

pytestmark = [pytest.mark.nightly, pytest.mark.root, pytest.mark.system]
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="makes network namespaces: needs root")
needs_ip = pytest.mark.skipif(not shutil.which("ip"), reason="needs iproute2")


@pytest.mark.xdist_group("lxd")
def test_calls_into_containers_stand_beside_those_into_a_process(lxd: OwnEngine, podman: OwnPodman) -> None:
    engines = ("--lxd", f"unix:{lxd.socket}", "--docker", f"unix://{podman.socket}")
    said = printed("bench.containers", "--quick", *engines)
    for what in "process", "lxd, stopped", "lxd, frozen", "docker, stopped", "docker, frozen":
        assert re.search(rf"\n{what} +[\d.]+ s \(", said)
    for what in "process", "lxd, frozen", "docker, frozen":
        assert re.search(rf"\n{what} +[\d.]+ ms +[\d.]+", said)


@needs_root
@needs_ip
def test_calls_are_measured_over_an_emulated_link() -> None:
    said = printed("bench.call", "--quick")
    assert re.search(r"\n(PASS|MISS): upwash on the server / 63.7 ms of bits / rate = [\d.]+", said)


@needs_root
@needs_ip
def test_a_server_a_second_away_is_used_and_one_behind_a_small_mtu_is_explained() -> None:
    said = printed("bench.links", "--quick")
    assert re.search(r"\n\| 1,000 ms \| 2 of 2 in ", said), said
    assert re.search(r"does not answer: small packets pass and large ones are lost: lower the MTU", said), (
        said
    )


@needs_root
@needs_ip
def test_answers_by_a_deadline_are_counted_in_simulation_and_over_links() -> None:
    said = printed("bench.deadlines", "--quick")
    for calls, number in ("simulated", "80"), ("flown", "5"):
        row = rf"\n\| {calls} \| two servers, with the deadline \| {number} \| [\d.]+.* \| [\d.]+ s .* \| [\d.]+.* \|"
        assert re.search(row, said), said


@needs_root
@needs_ip
def test_smaller_photos_are_scored_called_with_and_flown_with() -> None:
    said = printed("bench.less_to_send", "--quick")
    assert re.search(r"\n\| 0\.4 MB \| 2 \| 720 px, 85 \| \d+ kB \| [\d.]+ \|", said)
    assert re.search(r"\n\| 0\.4 MB \| 54 Mbit/s \|( [\d.]+ s \|){5}", said)
    assert re.search(
        r"\n\| 10 MB, as 1 MB \| [\d,]+ kB to \d+ kB in [\d.]+ s \|( \d+ s, [\d.]+ % \(.*?\) \|){3}", said
    )


@pytest.mark.xdist_group("ros")
@pytest.mark.skipif(not HAS_ROS, reason=NO_ROS)
@needs_root
@needs_ip
def test_calls_over_ros_are_measured_in_three_ways() -> None:
    said = printed("bench.ros", "--quick", "--python", PYTHON)
    for way in ("bare ROS 2 service", "FogROS2's way", "`upwash ros`"):
        assert re.search(rf"\| good link \| {way} \| [\d.]+ s \| [\d.]+ \|", said)
    assert re.search(r"\| black-out \| `upwash ros` \|.*\| (\d+) of \1 \|", said)


@pytest.mark.flight
@pytest.mark.xdist_group("emulate")
@needs_root
@needs_ip
def test_a_cell_of_the_thesis_is_flown_and_compared() -> None:
    said = printed("bench.validate", "--quick", "--only", "equal-servers-light/hitl")
    assert re.search(r"equal-servers-light/hitl +│ +table │ +namespaces │( +[\d.]+ │){3} +\d of 2 │", said)
