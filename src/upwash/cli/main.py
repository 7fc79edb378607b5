"""The command line: which commands there are, and how each of them ends.

A command is a module with `ARGUMENTS` and `run`: of this room, or of a plug-in's entry point of the group
`upwash.commands`. Only the module of the command that was typed is imported.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import os
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from typing import Any

from upwash.cli.exit_codes import ExitCode
from upwash.errors import (
    AutopilotNotHeard,
    AutopilotOverruled,
    MissionFailed,
    MissionStopped,
    NotKept,
    ReserveReached,
    UpwashError,
    UsageError,
)
from upwash.support.entry_points import COMMANDS, failing, find, load, names, origin, plug_ins, summary
from upwash.support.standard_streams import forgiving_streams, give_up_output, open_closed_streams
from upwash.support.text import escaped_lines

_COMMANDS = {
    "init": "make a folder with a mission, a service, configurations, keys and a test",
    "fly": "fly a mission",
    "check": "predict a mission, and warn of problems, before take-off",
    "ros": "run a ROS 2 node whose images are computed here or on a server",
    "serve": "run an edge daemon",
    "status": "ask an edge daemon for its leases, instances and refusals, or many whether they are well",
    "keys": "make an authority and certificates for servers and drones, or show them",
    "package": "make the image of a service, to run in containers",
    "images": "list the services that a daemon can run, and what is missing",
    "profile": "measure what a service's calls cost, here or at a server, for a configuration",
    "vehicle": "run a stand-in vehicle that speaks MAVLink",
    "demo": "fly the demonstration: a survey over two edge servers, all here",
    "simulate": "simulate a mission, or several drones', on virtual time",
    "view": "show flights on a page that moves: live, or played back",
    "report": "make a page, and files for other tools, from event logs",
    "reproduce": "fly the thesis's experiments, beside what it printed",
    "campaign": "simulate many missions, over seeds and settings",
    "compare": "fly every policy in the same scenarios, beside the bound; or compare flights by their logs",
    "traces": "make traces for simulations from an event log",
    "worlds": "draw worlds at random, as scenarios to compare policies in",
    "whatif": "predict a flight under other policies, from its log",
    "explain": "say why each call of a flight ran where it ran",
    "chaos": "simulate worlds full of faults and test what upwash promises",
    "emulate": "fly a scenario in real time, by real programs in network namespaces of their own (root)",
    "goodput": "compute a radio's goodput by distance with ns-3 (make native)",
}
_SHOW_THEMSELVES = frozenset({"fly", "ros", "serve", "vehicle", "demo", "view", "emulate"})
_SHOW_THEMSELVES_ON_A_TERMINAL = frozenset({"campaign", "chaos"})


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    open_closed_streams()
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # before gRPC is imported: upwash prints its own messages
    with forgiving_streams() as output:
        try:
            code = _run(sys.argv[1:] if arguments is None else arguments)
        except SystemExit as end:  # of argparse, which has printed why
            output.flush()
            if output.trouble is None:
                raise
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    if output.trouble is None:
        return code
    give_up_output()
    is_closed = isinstance(output.trouble, BrokenPipeError)  # the reader of a closed pipe wants no more
    if code != ExitCode.NOT_KEPT and not is_closed:
        _complain(UpwashError(f"standard output cannot be written ({output.trouble.strerror})"), code)
    return code or ExitCode.NOT_KEPT


def _run(arguments: Sequence[str]) -> int:
    command = next((word for word in arguments if not word.startswith("-")), None)
    try:
        parser = command_line(() if command is None else (command,))
    except UsageError as error:
        return _complain(error, ExitCode.USAGE, with_trace=not {"-v", "--verbose"}.isdisjoint(arguments))
    options = parser.parse_args(arguments)
    if "run" not in options:
        parser.print_help(sys.stderr)
        return ExitCode.USAGE
    # which the version and the help do without
    from upwash.cli.arguments import inputs_of, outputs_of
    from upwash.support.loading import look_here
    from upwash.support.progress import shown
    from upwash.support.spared import sparing

    look_here()
    complain = functools.partial(_complain, with_trace=options.verbose)
    try:
        with (
            sparing(inputs_of(options), outputs_of(options)),
            contextlib.nullcontext() if _shows_itself(options.command) else shown(options.command),
        ):
            return ExitCode.FAILURE if options.run(options) is False else ExitCode.DONE
    except UsageError as error:
        return complain(error, ExitCode.USAGE)
    except ReserveReached as error:
        return complain(UpwashError(f"the mission was ended early: {error}"), ExitCode.RESERVE)
    except MissionStopped as error:
        return complain(UpwashError(f"the mission was ended early: {error}"), ExitCode.INTERRUPTED)
    except MissionFailed as error:
        print(escaped_lines(error.trace), file=sys.stderr)
        return complain(error, ExitCode.FAILURE)
    except AutopilotNotHeard as error:
        return complain(error, ExitCode.NOT_HEARD)
    except NotKept as error:
        return complain(error, ExitCode.NOT_KEPT)
    except AutopilotOverruled as error:
        early = str(error).replace("mission: ", "the mission was ended early: ", 1)
        return complain(UpwashError(early), ExitCode.NOT_OURS)
    except UpwashError as error:
        return complain(error, ExitCode.FAILURE)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return complain(UpwashError(f"{place}{error.strerror or error}"), ExitCode.FAILURE)
    except _stops():
        print("upwash: stopped at once", file=sys.stderr)
        return ExitCode.INTERRUPTED


def _stops() -> tuple[type[BaseException], ...]:
    import asyncio  # which the help does without

    return KeyboardInterrupt, asyncio.CancelledError


def _shows_itself(command: str) -> bool:
    return command in _SHOW_THEMSELVES or (command in _SHOW_THEMSELVES_ON_A_TERMINAL and sys.stdout.isatty())


def command_line(words: Collection[str] = tuple(_COMMANDS)) -> argparse.ArgumentParser:
    """The parser of the command line; only the commands among `words` have their arguments.

    Plug-ins are looked for where `words` has none of upwash's own commands. Raises UsageError for an unknown command,
    or a command that cannot be loaded.
    """
    parser = argparse.ArgumentParser(
        prog="upwash",
        description="Runs a drone's heavy computations on the drone or on an edge server in reach.",
    )
    parser.add_argument("-V", "--version", action=_Version, nargs=0, help="print the version and end")
    _add_verbose(parser, default=False)
    commands = parser.add_subparsers(metavar="COMMAND")
    helps = _COMMANDS if not _COMMANDS.keys().isdisjoint(words) else _COMMANDS | _helps_of_plug_ins()
    for name in dict.fromkeys((*helps, *words)):
        command = commands.add_parser(
            name, help=helps.get(name), formatter_class=argparse.RawDescriptionHelpFormatter
        )
        if name in words:
            _complete(command, name)
        _add_verbose(command, default=argparse.SUPPRESS)
    return parser


def _helps_of_plug_ins() -> dict[str, str]:
    """The commands of plug-ins, each with what the metadata says: nothing is loaded for a list."""
    helps = dict[str, str]()
    for entry in plug_ins(COMMANDS):
        if entry.name in _COMMANDS:  # which no plug-in replaces
            continue
        said = f"{summary(entry)} (of {origin(entry)})".strip().replace("%", "%%")
        helps[entry.name] = f"{helps[entry.name]}; {said}" if entry.name in helps else said
    return helps


def _complete(command: argparse.ArgumentParser, name: str) -> None:
    """Gives the parser of a command its arguments; raises UsageError."""
    if name in _COMMANDS:
        _set(command, name, import_module(f"upwash.cli.{name}"))
    elif (entry := find(COMMANDS, name)) is not None:
        module = load(entry)
        with failing(COMMANDS, name, f"of {origin(entry)} has no usable ARGUMENTS and run", UsageError):
            _set(command, name, module)
    else:
        from upwash.config.problems import unknown  # only needed for errors

        raise UsageError(unknown("command", name, dict.fromkeys((*_COMMANDS, *names(COMMANDS)))))


def _set(command: argparse.ArgumentParser, name: str, module: Any) -> None:
    from upwash.cli.arguments import add_options  # which the version and the help do without

    named = tuple(add_options(command, module.ARGUMENTS))
    command.epilog = getattr(module, "EPILOG", None)
    command.set_defaults(run=module.run, command=name, named=named)


def _add_verbose(parser: argparse.ArgumentParser, *, default: object) -> None:
    parser.add_argument(
        "-v",
        "--verbose",
        action="store_true",
        default=default,
        help="say where in the code an error arose, too",
    )


class _Version(argparse.Action):
    """Look the version up only on demand: the lookup takes longer than all other parsing."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"upwash {version('upwash')}")
        parser.exit()


def _complain(error: UpwashError, code: int, *, with_trace: bool = False) -> int:
    with contextlib.suppress(OSError):
        if with_trace and (handled := sys.exc_info()[1]) is not None:
            import traceback  # only needed for errors

            print(escaped_lines("".join(traceback.format_exception(handled))), end="", file=sys.stderr)
        print(f"upwash: {escaped_lines(str(error))}", file=sys.stderr)
    return code
