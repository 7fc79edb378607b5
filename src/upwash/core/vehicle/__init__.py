"""The vehicle: its owner, its fences, and when its battery requires the way home.

Laws:
- a command is sent only while the vehicle is the program's; no report gives it back (control.py);
- a reported position that the vehicle's speed does not allow is doubted (continuity.py);
- more wind, a longer way, a higher consumption or less battery never makes the margin larger (energy.py).

    control      claims, commands and heartbeats → the owner
    continuity   reported positions → how far they can be wrong
    geofence     areas to stay in or keep out of
    course       a target or a stop → the moving point that leads a PX4
    way_home     times of a return and a landing
    energy       battery, wind and way home → the margin
    telemetry    what a mission reads of the vehicle
    payload      MAVLink commands that a mission may send
"""
