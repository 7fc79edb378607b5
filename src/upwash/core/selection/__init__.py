"""The drone's machine: events in, commands out (thesis sections 3.2 to 3.4).

    events             what happens        ─┐
    selection          takes an event      ─┼─► server_planning: which server now
    commands           what must be done   ◄┘   call_placement: where a call runs

Laws stand at the top of selection.py (the machine), radios.py (roles of servers) and recovery.py (after failures).

    moment             All parts share it: the time, the place, the drone's knowledge, and the effects.
    server_planning    Asks the policy, and announces the drone to the next server.
    call_placement     Local, remote, or wait.
    call_forecast      Where the calls to come will run.
    mission_times      When the mission is at each waypoint and over. Which calls run lighter.
    hedging            When the drone computes a late call itself.

What is ugly: the parts share one `Moment` and its servers, and change them: one event has one order of effects.
"""
