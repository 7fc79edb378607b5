"""upwash emulate: flies scenarios in real time, with real programs, on this machine."""

from __future__ import annotations

import argparse

from upwash.cli.arguments import FOLDER, new_run_folder, option, reads, repeated, require_linux
from upwash.emulation.enclosure import clean, require_root_and_tools
from upwash.emulation.request import EmulationRequest
from upwash.errors import UsageError
from upwash.support.loading import extra
from upwash.support.text import counted

ARGUMENTS = {
    "scenarios SCENARIO": reads("TOML files with the same servers", nargs="*"),
    "--drones N": option("fly each scenario with N drones at once", default=1),
    "--radio": option(
        "cables shaped by tables of goodput (default), or ns-3 in real time (make native)",
        choices=("table", "ns3"),
        default="table",
    ),
    "--in": option(
        "what the drones' and the servers' computers are: namespaces (default), or containers of LXD, where servers "
        "run their services in containers, too",
        choices=("namespaces", "containers"),
        default="namespaces",
        dest="computers",
    ),
    "--autopilot CONNECTION": repeated(
        "fly this vehicle instead of a stand-in, such as an ArduPilot's SITL; one for each drone",
        "autopilots",
    ),
    **FOLDER,
    "--clean": "only remove what a killed command left",
}


def run(options: argparse.Namespace) -> bool:
    """Emulate; true where every flight was completed, and measured well enough."""
    require_linux("emulate")
    with extra("emulation"):
        import tomli_w  # noqa: F401 - asked here, as the emulation itself is another process
    from upwash.emulation.run import run_emulation

    require_root_and_tools()
    killed = clean()
    if options.clean:
        print(
            f"killed {counted(killed, 'process')} of former emulations" if killed else "no process was left"
        )
        return True
    if not options.scenarios:
        raise UsageError("name a scenario, such as scenarios/demonstration.toml")
    request = EmulationRequest(
        scenarios=tuple(file.absolute() for file in options.scenarios),
        drones=options.drones,
        radio=options.radio,
        computers=options.computers,
        autopilots=tuple(options.autopilots),
        folder=(options.folder or new_run_folder()).absolute(),
    )
    return run_emulation(request)
