"""Whom a service instance answers."""

from __future__ import annotations

import pytest

from upwash.core.admission.clients import Client
from upwash.core.admission.instance_gate import InstanceGate
from upwash.errors import NoLease, Refused

D1, D2 = Client("d1", "f1"), Client("d2", "f2")


def refusal(gate: InstanceGate, client: Client) -> str:
    try:
        gate.require(client)
    except Refused as error:
        return str(error)
    return ""


def test_nobody_is_answered_before_somebody_is_admitted() -> None:
    with pytest.raises(Refused, match="drone d1 has no lease here"):
        InstanceGate().require(D1)


def test_those_admitted_last_are_answered_and_no_others() -> None:
    gate = InstanceGate()
    gate.admit([D1.key])
    assert refusal(gate, D1) == ""
    gate.admit([D2.key])
    assert refusal(gate, D2) == ""
    assert "no lease" in refusal(gate, D1)


def test_a_drone_is_known_by_its_certificate_and_not_by_its_name() -> None:
    gate = InstanceGate()
    gate.admit([D1.key])
    assert "drone d1 has no lease here" in refusal(gate, Client("d1", "stolen"))
    assert "drone (unnamed) has no lease here" in refusal(gate, Client(""))


def test_a_closed_gate_says_why_whoever_is_admitted() -> None:
    gate = InstanceGate()
    gate.admit([D1.key])
    assert gate.closed == ""
    gate.close("replaced")
    assert gate.closed == refusal(gate, D1) == "replaced"


def test_of_a_drone_whose_turn_is_over_what_has_arrived_is_answered_and_nothing_more() -> None:
    gate = InstanceGate()
    gate.admit([D1.key])
    gate.require(D1)
    gate.admit([D2.key], finishing=[D1.key])
    gate.require_still(D1)
    with pytest.raises(NoLease):
        gate.require(D1)
    gate.admit([D2.key])
    with pytest.raises(NoLease):
        gate.require_still(D1)
