"""What is scarce of a computer: below the least amount, until there is twice as much."""

from __future__ import annotations

import pytest

from upwash.core.knowledge.supplies import LEAST, Scarcity, Supplies, SupplyChange


@pytest.mark.parametrize("supply", LEAST)
def test_a_supply_is_scarce_until_there_is_twice_the_least(supply: str) -> None:
    scarcity, least = Scarcity(), LEAST[supply]  # type: ignore[index]
    told = [
        [(change.left, change.scarce) for change in scarcity.look(Supplies(**{supply: amount}))]
        for amount in (least, least - 1, 0, least, 2 * least - 1, 2 * least, least)
    ]
    assert told == [[], [(least - 1, True)], [], [], [], [(2 * least, False)], []]


def test_supplies_are_scarce_one_by_one() -> None:
    scarcity = Scarcity()
    assert list(scarcity.look(Supplies(files=3, disk=1e6))) == [
        SupplyChange("files", 3, True),
        SupplyChange("disk", 1e6, True),
    ]
    assert list(scarcity.look(Supplies(disk=2e6))) == [SupplyChange("files", float("inf"), False)]
    assert scarcity.scarce == {"disk": 2e6}
