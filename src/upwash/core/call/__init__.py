"""The life of a drone's calls: events in, instructions out, without I/O.

    steps.py        Events, and instructions to the program.
    calls.py        All calls of one drone: the line of calls, the lanes, and the drone's own computer.
    call.py         One call: its place, its attempts, and the one rule that accepts an answer.
    attempts.py     Where a call is attempted.
    outcomes.py     What an attempt at a server teaches.
    manner.py       What is attempted when. Each manner has a file:

    single.py       The first answer counts: of the drone, of a server, or of several places.
    twice.py        The drone answers at once. A server's answer by a deadline is better.
    on_servers.py   One server after the other gets the call. The call may end without an answer.

The first answer ends a call, unless the manner knows that a better answer may still come. An attempt that goes on
then is a loser. A loser holds its lane to its end, and its answer is dropped.
"""
