"""The life of a drone's calls: events in, instructions out, without I/O.

    steps.py        the events, and the instructions to the program
    calls.py        all calls of one drone: their line, its lanes, and the drone's own computer
    call.py         one call: its place, its attempts, and the one rule that accepts an answer
    attempts.py     where a call is attempted
    outcomes.py     what an attempt at a server teaches
    manner.py       what is attempted when; each manner has a file:

    single.py       on the drone, at a server, hedged, raced, overtaken, at a second server: the first answer counts
    twice.py        the drone's answer at once, and a server's by a deadline, which is better
    on_servers.py   at one server after the other, in line before each; a call may end without an answer

A call ends with the first answer, unless its manner knows of a better one that may still come. An attempt that goes
on then is a loser: it holds its lane to its end, and its answer is dropped.
"""
