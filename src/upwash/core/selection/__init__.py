"""The drone's machine: events in, commands out (thesis sections 3.2 to 3.4).

    events             what happens        ─┐
    selection          takes an event      ─┼─► server_planning: which server now
    commands           what must be done   ◄┘   call_placement: where a call runs

Laws stand at the top of selection.py (the machine), radios.py (roles of servers) and recovery.py (after failures).

    moment             what all parts share: what the drone knows, when and where it is, and what it does then
    server_planning    asks the policy, and announces the drone to the next server
    call_placement     local, remote, or wait
    call_forecast      where the calls to come will run
    mission_times      when the mission is at each waypoint and over; which calls run lighter
    hedging            when the drone computes a late call itself

What is ugly: the parts share one `Moment` and its servers, and change them: one event has one order of effects.
"""
