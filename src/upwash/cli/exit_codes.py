"""How a command ends, as scripts see it; docs/flight-ends.md has the same table."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """The codes."""

    DONE = 0
    FAILURE = 1
    USAGE = 2
    NOT_KEPT = 3
    RESERVE = 4
    NOT_OURS = 5
    NOT_HEARD = 6
    INTERRUPTED = 130


MEANINGS = {
    ExitCode.DONE: "success",
    ExitCode.FAILURE: "failure, a warning of a check, a server that is not well, or a broken promise",
    ExitCode.USAGE: "what was typed or configured cannot work; nothing was started",
    ExitCode.NOT_KEPT: "success, but a part of the event log or of the output could not be written",
    ExitCode.RESERVE: "the battery ended the mission, at the reserve",
    ExitCode.NOT_OURS: "the program does not have the vehicle: a person, a fail-safe or another program has it",
    ExitCode.NOT_HEARD: "the vehicle was never heard: the flight did not begin, and may be started again",
    ExitCode.INTERRUPTED: "ended by Ctrl-C or SIGTERM",
}
