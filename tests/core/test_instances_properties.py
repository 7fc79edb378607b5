"""Promise 11 under random requests, crashes and late news, with time passing.

Beside the machine under test stands a model of the daemon: it carries out the commands and knows from them alone
which processes live and whom they answer.
"""

from __future__ import annotations

import copy

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from upwash.core.admission.admission import (
    AdmissionController,
    AdmissionSettings,
    Available,
    ServiceRunning,
    StartPending,
)
from upwash.core.admission.clients import Client, Role
from upwash.core.admission.instances import InstanceState, StartInstance, StopInstance
from upwash.core.admission.leases import Admit
from upwash.core.admission.server import Command, Denied, ServerOffer
from upwash.core.admission.usage import LeaseEnded

OFFERED = {"s1": ["counter", "detector"], "s2": ["detector"]}
SETTINGS = AdmissionSettings(lease_s=30.0, idle_stop_s=100.0, hold_s=50.0)
TURN_S = 30.0
PEER = Client("s3", "53", Role.SERVER)

servers = st.sampled_from(list(OFFERED))
services = st.sampled_from(["counter", "detector"])
drones = st.sampled_from(["d1", "d2", "d3"])


class Daemon(RuleBasedStateMachine):
    """Drones come, ask, call, leave or fall silent; instances start, fail, crash and stop."""

    @initialize(slots=st.fixed_dictionaries({"s1": st.integers(1, 2), "s2": st.integers(0, 2)}))
    def boot(self, slots: dict[str, int]) -> None:
        self.slots = slots
        self.host = AdmissionController(
            {name: ServerOffer(frozenset(images), slots[name]) for name, images in OFFERED.items()},
            SETTINGS,
            peers=[PEER.name],
        )
        self.now_s = 0.0
        self.admitted: dict[str, frozenset[str]] = dict.fromkeys(OFFERED, frozenset())
        self.lease_ends_s: dict[tuple[str, str], float] = {}
        self.expected: set[tuple[str, str]] = set()  # those that have not come yet
        self.living: dict[tuple[str, str], int] = {}
        self.serving: dict[tuple[str, str], str] = {}
        self.stopping: set[tuple[str, str]] = set()
        self.used_s: dict[tuple[str, str], float] = {}
        self.born: list[tuple[str, str, int]] = []
        self.coming: dict[tuple[str, str], int] = {}  # those of another version, beside one that serves
        self.former_s: dict[tuple[str, str, int], float] = {}  # those whose place another has, and until when

    # ---- what happens

    @rule(step_s=st.sampled_from([0.0, 1.0, 14.0, 29.0, 30.0, 100.0]))
    def time_passes(self, step_s: float) -> None:
        self.now_s += step_s

    @rule()
    def look(self) -> None:
        self.carry_out(self.host.look(now_s=self.now_s))
        assert all(end_s > self.now_s for end_s in self.lease_ends_s.values()), "a lease outlived its time"
        assert all(until_s > self.now_s for until_s in self.former_s.values()), "a former one still runs"
        for place in self.serving.keys() - self.stopping:
            if not self.admitted[place[0]]:
                assert self.now_s - self.used_s[place] < SETTINGS.idle_stop_s, "an idle instance still runs"

    @rule(server=servers, wanted=st.lists(services, max_size=2), drone=drones)
    def drone_asks(self, server: str, wanted: list[str], drone: str) -> None:
        before = self.after_a_look()
        answer, commands = self.host.availability(server, wanted, Client(drone), now_s=self.now_s)
        self.answered(
            server, wanted, drone, granted=isinstance(answer, Available), before=before, commands=commands
        )
        if isinstance(answer, Available):
            assert answer.endpoints == {
                service: self.serving[server, service]
                for service in wanted
                if (server, service) in self.serving.keys() - self.stopping
            }

    @rule(server=servers, service=services, drone=drones)
    def drone_wants_a_start(self, server: str, service: str, drone: str) -> None:
        place, before, lived = (server, service), self.after_a_look(), dict(self.living)
        answer, commands = self.host.start(server, service, Client(drone), now_s=self.now_s)
        self.answered(
            server, [service], drone, granted=not isinstance(answer, Denied), before=before, commands=commands
        )
        started = [command for command in commands if isinstance(command, StartInstance)]
        match answer:
            case ServiceRunning(endpoint):
                assert self.serving[place] == endpoint
                assert place not in self.stopping
                assert started == []
            case StartPending(number, stopping):
                assert self.living[place] == number
                assert stopping == (place in self.stopping)
                assert started == ([] if place in lived else [StartInstance(server, service, number)])
            case Denied():
                assert started == []

    @rule(
        server=servers,
        wanted=st.lists(services, max_size=2),
        drone=drones,
        for_s=st.sampled_from([0.0, 20.0, 50.0, 1e6]),
    )
    def peer_sends_word(self, server: str, wanted: list[str], drone: str, for_s: float) -> None:
        before, end_s = self.after_a_look(), self.now_s + min(for_s, SETTINGS.hold_s)
        known_s = self.lease_ends_s.get((server, drone), self.now_s)
        has_come = known_s > self.now_s and (server, drone) not in self.expected
        answer, commands = self.host.hold(
            server, wanted, Client(drone), peer=PEER, for_s=for_s, now_s=self.now_s
        )
        is_held = answer is None
        others = sum(
            each == server and name != drone and self.has_lease(each, name) for each, name in self.expected
        )
        is_half = others >= max(1, self.slots[server] // 2)
        in_vain = isinstance(answer, Denied) and answer.why.endswith("expected did not come")
        self.answered(
            server,
            wanted,
            drone,
            granted=is_held,
            before=before,
            commands=commands,
            allowed=not (is_half or in_vain),
            asks=False,
        )
        if is_held:
            self.lease_ends_s[server, drone] = max(known_s, end_s) if has_come else end_s
            if not has_come:
                self.expected.add((server, drone))
            assert {command.service for command in commands if isinstance(command, StartInstance)} <= set(
                wanted
            )

    @rule(server=servers, drone=drones)
    def drone_leaves(self, server: str, drone: str) -> None:
        self.lease_ends_s.pop((server, drone), None)
        self.carry_out(self.host.leave(server, Client(drone), now_s=self.now_s))

    @precondition(lambda self: self.serving)
    @rule(data=st.data(), drone=drones)
    def drone_calls(self, data: st.DataObject, drone: str) -> None:
        server, service = data.draw(st.sampled_from(sorted(self.serving)))
        self.host.at(server).called(service, self.living[server, service], drone, now_s=self.now_s)
        if self.has_lease(server, drone):
            self.used_s[server, service] = self.now_s

    @rule(server=servers, drone=drones)
    def daemon_sees_the_drone(self, server: str, drone: str) -> None:
        self.host.at(server).seen(drone, now_s=self.now_s)
        if self.has_lease(server, drone):  # one that is over stays over
            ends_s = self.now_s + SETTINGS.lease_s
            self.lease_ends_s[server, drone] = max(ends_s, self.lease_ends_s[server, drone])

    @rule(server=servers, service=services)
    def another_version_is_there(self, server: str, service: str) -> None:
        place = (server, service)
        offers = {name: ServerOffer(frozenset(images), self.slots[name]) for name, images in OFFERED.items()}
        commands = self.host.offer(offers, outdated=frozenset({place}))
        starts = [command for command in commands if isinstance(command, StartInstance)]
        stops = [command.number for command in commands if isinstance(command, StopInstance)]
        if place in self.serving.keys() - self.stopping:
            (start,) = starts
            assert stops == ([self.coming[place]] if place in self.coming else [])
            self.coming[place] = start.number
            self.born.append((server, service, start.number))
        elif place in self.living.keys() - self.stopping:
            assert (starts, stops) == ([], [self.living[place]])
            self.stopping.add(place)
        else:
            assert commands == []

    def has_lease(self, server: str, drone: str) -> bool:
        return self.lease_ends_s.get((server, drone), self.now_s) > self.now_s

    @precondition(lambda self: self.born)
    @rule(data=st.data())
    def instance_is_ready(self, data: st.DataObject) -> None:
        server, service, number = data.draw(st.sampled_from(self.born))
        place, endpoint = (server, service), f"{server}:{9000 + number}"
        commands = self.host.at(server).ready(service, number, endpoint, now_s=self.now_s)
        is_next = self.coming.get(place) == number
        if is_next:
            self.former_s[*place, self.living[place]] = self.now_s + SETTINGS.lease_s
            self.living[place] = self.coming.pop(place)
        if is_next or (
            self.living.get(place) == number and place not in self.serving and place not in self.stopping
        ):
            assert commands == [Admit(server, self.admitted[server])], "the new instance knows nobody yet"
            self.serving[place] = endpoint
            self.used_s[place] = self.now_s
        else:
            assert commands == [], "news of another instance, or no news"

    @precondition(lambda self: self.born)
    @rule(data=st.data())
    def instance_is_gone(self, data: st.DataObject) -> None:
        server, service, number = data.draw(st.sampled_from(self.born))
        place = (server, service)
        self.host.at(server).gone(service, number)
        self.former_s.pop((server, service, number), None)
        if self.coming.get(place) == number:
            del self.coming[place]
        if self.living.get(place) == number:
            del self.living[place]
            self.serving.pop(place, None)
            self.stopping.discard(place)
            if place in self.coming:
                self.living[place] = self.coming.pop(place)

    # ---- the daemon

    def after_a_look(self) -> tuple[AdmissionController, list[Command]]:
        """The host as a mere look at this moment would leave it, and whom the look wants admitted."""
        looked = copy.deepcopy(self.host)
        commands = looked.look(now_s=self.now_s)
        return looked, [command for command in commands if isinstance(command, Admit | LeaseEnded)]

    def answered(
        self,
        server: str,
        wanted: list[str],
        drone: str,
        *,
        granted: bool,
        before: tuple[AdmissionController, list[Command]],
        commands: list[Command],
        allowed: bool = True,
        asks: bool = True,
    ) -> None:
        """A request is granted where there are images and a slot; one that is denied only ends leases.

        Where others wait for a slot turns.py says whose it is: one that is free, or the one of a drone that yields.
        """
        looked, expected = before
        holders = looked.leases(server)
        accounts = next(each.accounts for each in looked.servers(now_s=self.now_s) if each.name == server)
        others = {account.drone for account in accounts if account.waits_s is not None} - (
            {drone} if asks else set()
        )
        free = self.slots[server] - len(holders)
        room = drone in holders or free > len(others)
        possible = allowed and set(wanted) <= set(OFFERED[server])
        yields = holders - self.host.leases(server)
        if asks and drone not in holders and (others or yields):
            assert not granted or possible
        else:
            assert granted == (possible and room)
        for account in accounts:
            if account.drone in yields:
                assert asks and granted and account.holds_s is not None and account.holds_s >= TURN_S
                self.lease_ends_s[server, account.drone] = self.now_s
        self.carry_out(commands)
        if granted:
            self.lease_ends_s[server, drone] = self.now_s + SETTINGS.lease_s
            self.expected.discard((server, drone))
        else:
            assert commands == expected
            for name in OFFERED:
                assert self.host.leases(name) == looked.leases(name)

    def carry_out(self, commands: list[Command]) -> None:
        for command in commands:
            match command:
                case Admit(server, admitted, finishing):
                    assert not finishing & admitted
                    for drone in self.admitted[server] - admitted:
                        end_s = self.lease_ends_s.pop((server, drone), self.now_s)
                        assert end_s <= self.now_s, "a lease ended before its time"
                    self.admitted[server] = admitted
                case StartInstance(server, service, number):
                    assert (server, service) not in self.living, "two instances of one service"
                    assert all(number != earlier for _, _, earlier in self.born)
                    self.living[server, service] = number
                    self.born.append((server, service, number))
                case StopInstance(server, service, number):
                    place = (server, service)
                    until_s = self.former_s.pop((server, service, number), None)
                    if until_s is not None and until_s <= self.now_s:
                        continue
                    assert not self.admitted[server], "stopped under a drone"
                    assert self.now_s - self.used_s[place] >= SETTINGS.idle_stop_s
                    if self.coming.get(place) == number:
                        del self.coming[place]
                    elif until_s is None:
                        assert self.living[place] == number
                        assert place in self.serving.keys() - self.stopping
                        self.stopping.add(place)

    # ---- what always holds

    @invariant()
    def no_more_leases_than_slots(self) -> None:
        for server, slots in self.slots.items():
            assert len(self.host.leases(server)) <= slots

    @invariant()
    def those_with_a_lease_and_no_others_are_admitted(self) -> None:
        for server, admitted in self.admitted.items():
            assert self.host.leases(server) == admitted
            assert {drone for name, drone in self.lease_ends_s if name == server} == admitted

    @invariant()
    def every_instance_is_where_it_is_believed_to_be(self) -> None:
        for server, images in OFFERED.items():
            for service in images:
                place = (server, service)
                expected = InstanceState.ABSENT
                if place in self.stopping:
                    expected = InstanceState.STOPPING
                elif place in self.serving:
                    expected = InstanceState.RUNNING
                elif place in self.living:
                    expected = InstanceState.STARTING
                assert self.host.at(server).state(service) is expected


class ManyDaemons(Daemon):
    """The same, with enough daemons to meet what is rare."""


UNHURRIED = settings(stateful_step_count=40, deadline=None)
TestDaemon = Daemon.TestCase
TestDaemon.settings = settings(UNHURRIED, max_examples=100)
TestManyDaemons = pytest.mark.nightly(ManyDaemons.TestCase)
TestManyDaemons.settings = settings(UNHURRIED, max_examples=500)
