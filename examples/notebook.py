"""What a notebook does with upwash: two policies in one scenario, call by call and over several seeds.

Run it: python examples/notebook.py
"""

from pathlib import Path

import upwash

SCENARIO = Path(__file__).with_name("patrol.toml")
POLICIES = ("local-only", "look-ahead")


def one_flight_each() -> None:
    """Where each call ran and how long the mission waited for it, as bars."""
    for policy in POLICIES:
        flight = upwash.simulate(SCENARIO, policy=policy)
        on_drone = f"{flight.totals.local} of {flight.totals.calls} calls on the drone"
        print(f"{policy}: {flight.mission_time_s:.1f} s, {on_drone}")
        for call in flight.calls:
            print(
                f"    waypoint {call.waypoint}  {'#' * round(4 * call.delay_s)} {call.delay_s:.1f} s ({call.place})"
            )


def many_flights_each() -> None:
    """The mean mission times by how far the server reaches, beside that of an all-knowing drone."""
    print("range   policy       mission         at best")
    for range_m in (20.0, 40.0, 80.0):
        rows = upwash.compare(
            {f"{range_m:.0f} m": SCENARIO},
            policies=POLICIES,
            seeds=5,
            overrides={"server.s1.range_m": range_m},
        )
        for row in rows:
            mission = f"{row.mean_s:.1f} ± {row.half_width_s:.1f} s"
            print(f"{row.scenario:<7} {row.policy:<12} {mission:<15} {row.bound_s:.1f} s")


if (
    __name__ == "__main__"
):  # a notebook needs no such line; what takes longer than this is spread over processes
    one_flight_each()
    many_flights_each()
