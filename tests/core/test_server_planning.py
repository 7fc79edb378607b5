"""When word is sent ahead: early enough for a start, to peers alone, and once for as long as a slot is held."""

from __future__ import annotations

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.servers import Server, Trigger
from upwash.core.policies.policy import Coming
from upwash.core.selection.commands import Prepare
from upwash.core.selection.server_planning import PrewarmNotifier

START_S = 8.0


def server(*peers: str, ready: bool = True) -> Server:
    found = Server("a", Circle(Position(0.0, 0.0), 50.0), peers=frozenset(peers))
    found.check = 1
    for event in (Trigger.SELECTED, Trigger.STARTED) if ready else (Trigger.SELECTED,):
        found.apply(event, now_s=0.0)
    return found


def announce(
    notifier: PrewarmNotifier, current: Server | None, coming: Coming | None, now_s: float = 0.0
) -> list[Prepare]:
    return notifier.announce(current, coming, start_s=START_S, now_s=now_s)


def test_the_coming_server_is_prepared_by_the_one_that_is_ready() -> None:
    notifier = PrewarmNotifier()
    assert announce(notifier, server("b"), Coming("b", 12.0)) == [Prepare("a", 1, "b", 12.0, 15.0)]
    assert notifier.has_announced("b", at_s=26.9)
    assert not notifier.has_announced("b", at_s=27.0)


def test_nothing_is_sent_to_strangers_or_by_a_server_that_is_not_ready() -> None:
    notifier = PrewarmNotifier()
    assert announce(notifier, server("c"), Coming("b", 12.0)) == []
    assert announce(notifier, server("b", ready=False), Coming("b", 12.0)) == []
    assert announce(notifier, server("b"), None) == []
    assert announce(notifier, None, Coming("b", 12.0)) == []
    assert not notifier.is_due(1e9)


def test_it_waits_until_a_start_and_a_margin_are_left() -> None:
    notifier = PrewarmNotifier()
    assert announce(notifier, server("b"), Coming("b", 60.0)) == []
    assert not notifier.is_due(41.9)
    assert notifier.is_due(42.0)
    assert announce(notifier, server("b"), Coming("b", 18.0), 42.0) == [Prepare("a", 1, "b", 18.0, 15.0)]
    assert not notifier.is_due(1e9)


def test_word_is_sent_again_when_the_slot_is_held_no_longer() -> None:
    notifier = PrewarmNotifier()
    announce(notifier, server("b"), Coming("b", 5.0))
    assert announce(notifier, server("b"), Coming("b", 5.0), 19.9) == []
    assert notifier.is_due(20.0)
    assert announce(notifier, server("b"), Coming("b", 5.0), 20.0) != []
