from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Position, Velocity, distance_m
from upwash.vehicle.body.kinematics import Motion, braking, duration_s, leg

HERE = Position(0.0, 0.0, 20.0)
metres = st.floats(-500, 500).filter(lambda value: value == 0 or abs(value) > 1e-3)
positions = st.builds(Position, metres, metres, metres)
speeds_m_s = st.floats(0.5, 20)
accelerations_m_s2 = st.floats(0.5, 20)


def test_a_leg_of_20_m_at_4_m_s_and_1_m_s2_takes_9_s() -> None:
    phases = leg(HERE, Position(20.0, 0.0, 20.0), cruise_m_s=4.0, acceleration_m_s2=1.0)
    assert duration_s(phases) == pytest.approx(9.0)
    assert [phase.duration_s for phase in phases] == pytest.approx([4.0, 1.0, 4.0])


def test_a_short_leg_turns_from_speeding_up_to_braking_halfway() -> None:
    phases = leg(HERE, Position(0.0, 4.0, 20.0), cruise_m_s=4.0, acceleration_m_s2=1.0)
    assert duration_s(phases) == pytest.approx(4.0)
    halfway = Motion(0.0, phases, Position(0.0, 4.0, 20.0))
    assert halfway.position(2.0).north_m == pytest.approx(2.0)
    assert halfway.velocity(2.0).speed_m_s == pytest.approx(2.0)


def test_a_leg_to_where_it_starts_takes_no_time() -> None:
    assert leg(HERE, HERE, cruise_m_s=4.0, acceleration_m_s2=1.0) == ()


@pytest.mark.parametrize(("cruise_m_s", "acceleration_m_s2"), [(0.0, 1.0), (4.0, 0.0), (math.nan, 1.0)])
def test_a_leg_that_would_never_end_is_an_error(cruise_m_s: float, acceleration_m_s2: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        leg(HERE, Position(20.0, 0.0), cruise_m_s=cruise_m_s, acceleration_m_s2=acceleration_m_s2)


def test_braking_from_4_m_s_with_1_m_s2_needs_8_m() -> None:
    (phase,) = braking(HERE, Velocity(east_m_s=-4.0), acceleration_m_s2=1.0)
    assert phase.duration_s == pytest.approx(4.0)
    assert phase.end.east_m == pytest.approx(-8.0)
    assert braking(HERE, Velocity(), acceleration_m_s2=1.0) == ()


@given(start=positions, end=positions, cruise_m_s=speeds_m_s, acceleration_m_s2=accelerations_m_s2)
def test_a_leg_jumps_neither_in_place_nor_in_speed(
    start: Position, end: Position, cruise_m_s: float, acceleration_m_s2: float
) -> None:
    phases = leg(start, end, cruise_m_s=cruise_m_s, acceleration_m_s2=acceleration_m_s2)
    motion = Motion(100.0, phases, end)
    steps = 60
    step_s = duration_s(phases) / steps
    for i in range(-1, steps + 1):
        now_s = 100.0 + i * step_s
        moved_m = distance_m(motion.position(now_s), motion.position(now_s + step_s))
        sped_up_m_s = motion.velocity(now_s + step_s).speed_m_s - motion.velocity(now_s).speed_m_s
        assert moved_m <= cruise_m_s * step_s + 1e-6
        assert abs(sped_up_m_s) <= acceleration_m_s2 * step_s + 1e-6
        assert motion.velocity(now_s).speed_m_s <= cruise_m_s + 1e-6
    assert motion.position(99.0) == start or not phases
    assert motion.position(motion.ends_s + 1.0) == end
    assert motion.velocity(motion.ends_s + 1.0) == Velocity()
