"""upwash view: shows flights on a page, live or afterwards."""

from __future__ import annotations

import argparse
import asyncio
import os

from upwash.cli.arguments import LIVE_PORT, MAP, announce, option, port, reads
from upwash.cli.other_policies import OTHERS_FLY, others_flown
from upwash.report.reviews import logs_among
from upwash.support.loading import extra

_NICENESS = 10  # a flight that goes on beside it comes first, and the page is not starved


ARGUMENTS = {
    "logs LOG": reads(
        "event logs, of flights under way or over: those of several drones are shown on one map, and up to three of "
        "one drone",
        nargs="+",
    ),
    "--port": option(f"on this machine (default: {LIVE_PORT}; 0: any)", type=port, default=LIVE_PORT),
    "--scenario FILE": reads(OTHERS_FLY),
    "--photos FOLDER": reads("where the photos are that the log names"),
    **MAP,
}


def run(options: argparse.Namespace) -> None:
    """Serve the page until Ctrl-C."""
    with extra("view"):
        from upwash.view.serve import serve_view
        from upwash.view.tiles import base_map

    os.nice(_NICENESS)
    asyncio.run(
        serve_view(
            logs_among(options.logs),
            port=options.port,
            photos=options.photos,
            flown=others_flown(options.logs, options.scenario),
            beneath=base_map(options.tiles, options.credit) if options.tiles else None,
            ready=lambda address: announce(f"view ready at {address}"),
        )
    )
