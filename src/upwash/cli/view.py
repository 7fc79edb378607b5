"""upwash view: shows flights on a page, live or afterwards."""

from __future__ import annotations

import argparse
import asyncio
import os
from pathlib import Path

from upwash.cli.arguments import LIVE_PORT, announce, port
from upwash.support.loading import extra

_NICENESS = 10  # a flight that goes on beside it comes first, and the page is not starved


def add(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "logs", type=Path, nargs="+", metavar="LOG",
        help="event logs, of flights under way or over: those of several drones are shown on one map, those of one "
        "drone side by side",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=port, default=LIVE_PORT, help=f"on this machine (default: {LIVE_PORT}; 0: any)"
    )
    parser.add_argument(
        "--photos", type=Path, metavar="FOLDER", help="where the photos are that the log names"
    )
    parser.add_argument(
        "--tiles",
        metavar="URL",
        help="load map tiles from there: https://HOST/{z}/{x}/{y}.png (default: none)",
    )
    parser.add_argument("--credit", default="", metavar="TEXT", help="the credit to show for the tiles")


def run(options: argparse.Namespace) -> bool:
    """Serve the page until Ctrl-C."""
    with extra("view"):
        from upwash.view.serve import serve_view
        from upwash.view.tiles import Tiles

    os.nice(_NICENESS)
    asyncio.run(
        serve_view(
            options.logs,
            port=options.port,
            photos=options.photos,
            tiles=Tiles(options.tiles, options.credit) if options.tiles else None,
            ready=lambda address: announce(f"view ready at {address}"),
        )
    )
    return True
