"""Models: the ports of the programs, computed instead of provided by things.

- One clock: the event loop of `loop.py` jumps to the next timer. It refuses sockets, processes and threads.
- One thread at a time: `turns.py` hands the turn from the loop's thread to a mission's and back.
- One seed: all chance of a run comes from named streams of `chance.py`, so a new consumer changes no other's draws.
- A program cannot tell a model from a thing. Faults sit in the models around the programs (`faults.py`).

The vehicle is `vehicle.py` (how it moves), `borders.py` (when it crosses a circle), `incidents.py` (what happens to
it) and `energy.py`; `vehicle_link.py` is what a program receives of it, and `autopilot.py` the port. Servers are
`world.py` (times), `runtime.py` (instances), `radio.py` (goodput) and `link.py` (requests).

Ugly: the loop uses private parts of asyncio's base class, as it runs thousands of callbacks a mission; and
`time.sleep` is replaced while a simulation runs, to warn of missions that sleep.
"""
