"""upwash ros: a ROS 2 node whose images are computed on the drone or on a server."""

from __future__ import annotations

import argparse
import asyncio

from upwash.cli.arguments import config_of, new_run_folder, option, writes
from upwash.config.drone_file import drone_config, refuse_several
from upwash.config.reading import read_document

_NO_MISSION = {"waypoints_m": [[0, 0]]}

ARGUMENTS = {
    **config_of("drone"),
    "--log": writes("where the event log goes (default: runs/TIME/events.jsonl)"),
    "--managed": "wait until a lifecycle manager configures and activates the node",
    "--ros-args ARGS": option(
        "arguments of ROS 2, such as -r image/compressed:=/camera/image/compressed; all that follow",
        nargs=argparse.REMAINDER,
        default=[],
    ),
}


def run(options: argparse.Namespace) -> None:
    """Run the node until Ctrl-C; a configuration for it needs no mission."""
    from upwash.launch.ros import serve_ros

    document = read_document(options.config)
    config = drone_config(
        {"mission": _NO_MISSION, **document} if "service" in document else document, options.config
    )
    refuse_several(config, options.config, what="a node")
    args = ["--ros-args", *options.ros_args] if options.ros_args else []
    asyncio.run(
        serve_ros(
            config,
            log=options.log or new_run_folder() / "events.jsonl",
            args=args,
            managed=options.managed,
        )
    )
