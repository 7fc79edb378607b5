"""The life of a drone's calls: events in, instructions out, without I/O.

`Calls` (calls.py) has all calls of one drone: the line in which they wait, and the drone's own computer. `Call`
(call.py) is the life of one call. Each manner of a call is a plan of attempts of one kind: where an attempt runs, as
which operation, and when it begins.

    manner              attempts                                                  the answer that counts
    local               on the drone; a server that becomes READY overtakes it    the first
    remote              at a server; on the drone once that has failed            the first
    hedged              at a server; on the drone where the server is late        the first
    raced               at a server on trial and on the drone, at once            the first
    with a deadline     at a server; at a second server where the first is late   the first
    with two answers    at servers, one after the other; the drone's own answer   a server's, by the deadline
                        is told at once
    only on servers     at servers, one after the other, in line before each      the first, or none in time
    once                on the drone, whatever happens                            the only one

One rule accepts answers: the first one ends the call, unless it is the first of two and a better one may still come.
An attempt that goes on then is a loser: it holds its lane to its end, and its answer is dropped.
"""
