"""What can be known before take-off: what is covered, how long the mission takes, what may cause problems.

- A check flies the file in simulation, in cases: as configured, local-only, and without servers (`prediction.py`).
- `waypoints.py` has coverage and the way home, `warnings.py` every warning with a kind that stays the same.
- `check.py` and `display.py` are for one drone, `fleet.py` for several, `capacity.py` for more and more of them.
- `surveys.py` looks at real networks, servers and vehicles. Nothing else here touches a thing, except that a file for
  a flight has its camera and services tried.
"""
