"""What the drone knows: the servers and their states, the delays to expect, and where servers are in range.

Laws:
- a server's state changes by `servers.TRANSITIONS` alone; any other step raises TransitionError;
- an estimate is the mean of the last three observations, and begins with the configured belief;
- a server without a range (`geo.Measured`) is in range everywhere; `coverage` has what calls measured at each place.

    servers     the state of each server, and what time alone changes
    estimates   delays of calls and checks
    coverage    measured places of servers without a range
    ranges      the ranges around a place, and the borders that a drone crosses

What is ugly: `Estimates` remembers where the drone is, because a delay depends on it for servers without a range.
"""
