"""The command line: arguments in, one call each."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from upwash.errors import MissionStopped, UpwashError, UsageError

_OK, _FAILURE, _USAGE, _INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns 0 when it did what it should, 2 for bad usage, 1 for any other failure."""
    options = _parser().parse_args(arguments)
    sys.path.append(str(Path.cwd()))  # so that `my_mission:fly` is found, as `python -m` would find it
    try:
        done: int = options.run(options)
    except UsageError as error:
        return _complain(error, _USAGE)
    except MissionStopped as error:
        print(f"upwash: the mission was ended early: {error}", file=sys.stderr)
        return _INTERRUPTED
    except UpwashError as error:
        return _complain(error, _FAILURE)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(UpwashError(f"{place}{error.strerror or error}"), _FAILURE)
    except (KeyboardInterrupt, asyncio.CancelledError):
        return _INTERRUPTED
    return done


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="upwash",
        description="Runs a drone's heavy computations on the drone or on an edge server in reach.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    fly = commands.add_parser("fly", help="fly a mission")
    fly.add_argument(
        "mission", nargs="?", help="survey, or path/to/file.py:function (default: as configured)"
    )
    fly.add_argument("--config", type=Path, required=True, help="the drone's configuration, a TOML file")
    fly.add_argument("--autopilot", metavar="CONNECTION", help="instead of the configured one")
    fly.add_argument("--log", type=Path, help="where the event log goes (default: runs/TIME/events.jsonl)")
    fly.set_defaults(run=_fly)

    serve = commands.add_parser("serve", help="run an edge daemon")
    serve.add_argument("--config", type=Path, required=True, help="the daemon's configuration, a TOML file")
    serve.set_defaults(run=_serve)

    keys = commands.add_parser("keys", help="make an authority and certificates for servers and drones")
    keys.add_argument("folder", type=Path, help="where they go; an authority that is there is used again")
    keys.add_argument(
        "--server", action="append", default=[], metavar="NAME[,NAME]",
        help="a certificate for a daemon that acts as the server, or as each of several",
    )  # fmt: skip
    keys.add_argument(
        "--drone", action="append", default=[], metavar="NAME", help="a certificate for a drone"
    )
    keys.set_defaults(run=_keys)

    vehicle = commands.add_parser("vehicle", help="run a stand-in vehicle that speaks MAVLink")
    vehicle.add_argument("--listen", default="udp:127.0.0.1:14550", help="udp:HOST:PORT or tcp:HOST:PORT")
    vehicle.add_argument(
        "--home", type=_place, default="39.3666,22.9507", metavar="LAT,LON", help="where it stands"
    )
    vehicle.add_argument(
        "--armable-after", type=float, default=42.0, metavar="S", help="after boot, in seconds (default: 42)"
    )
    vehicle.add_argument(
        "--speedup", type=float, default=1.0, metavar="N", help="let its clock run so many times as fast"
    )
    vehicle.add_argument(
        "--acceleration", type=float, metavar="M_S2",
        help="speed up and brake alike, in m/s² (default: as a recorded ArduCopter did)",
    )  # fmt: skip
    vehicle.add_argument(
        "--battery", type=float, default=100.0, metavar="PERCENT", help="how full it is at boot"
    )
    vehicle.add_argument(
        "--fault", action="append", default=[], dest="faults", metavar="KIND[:FROM[-TO]]",
        help="link, gps, battery or arming, from and to seconds after boot",
    )  # fmt: skip
    vehicle.set_defaults(run=_vehicle)

    demo = commands.add_parser("demo", help="fly the demonstration: a survey over two edge servers, all here")
    demo.add_argument("--folder", type=Path, help="where everything of the run goes (default: runs/TIME)")
    demo.set_defaults(run=_demo)

    simulate = commands.add_parser("simulate", help="simulate one mission on virtual time")
    simulate.add_argument("scenario", type=Path, help="the scenario, a TOML file")
    simulate.add_argument(
        "--policy",
        choices=("local-only", "opportunistic", "location-aware"),
        help="instead of the scenario's",
    )
    simulate.add_argument("--seed", type=int, metavar="N", help="instead of the scenario's")
    simulate.add_argument("--json", action="store_true", help="print the result as one JSON object")
    simulate.add_argument(
        "--log", type=Path, metavar="FILE", help="where the event log goes (default: nowhere)"
    )
    simulate.add_argument(
        "--figures", type=Path, metavar="DIR", help="draw the map and the call delays there"
    )
    simulate.set_defaults(run=_simulate)

    reproduce = commands.add_parser("reproduce", help="fly the thesis's experiments, beside what it printed")
    reproduce.add_argument(
        "--seeds", type=_count, default=30, metavar="N", help="missions per cell (default: 30)"
    )
    reproduce.add_argument("--figures", type=Path, metavar="DIR", help="draw the figures 4.4 to 4.12 there")
    reproduce.set_defaults(run=_reproduce)

    campaign = commands.add_parser("campaign", help="simulate many missions, over seeds and settings")
    campaign.add_argument("scenario", type=Path, help="the scenario, a TOML file")
    campaign.add_argument("--seeds", type=_count, required=True, metavar="N", help="missions per combination")
    campaign.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=V1,V2",
        help="fly it with each of these values of a key, such as policy.gain_wait or server.s1.range_m",
    )  # fmt: skip
    where = campaign.add_mutually_exclusive_group()
    where.add_argument("--workers", type=_count, metavar="N", help="processes here (default: one per core)")
    where.add_argument("--cluster", metavar="ADDRESS", help="fly on a Dask cluster, such as tcp://HOST:8786")
    campaign.add_argument(
        "--out", type=Path, metavar="FILE",
        help="a .csv or .parquet file; an interrupted campaign is continued there (default: one in runs/)",
    )  # fmt: skip
    campaign.set_defaults(run=_campaign)
    return parser


def _place(text: str) -> tuple[float, float]:
    try:
        latitude_deg, longitude_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LAT,LON in degrees, such as 39.3666,22.9507"
        ) from None
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no place: latitudes go from -90 to 90, longitudes to 180 degrees"
        )
    return latitude_deg, longitude_deg


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def _fly(options: argparse.Namespace) -> int:
    os.environ.setdefault("GRPC_VERBOSITY", "ERROR")  # what matters is in the event log, once
    import msgspec

    from upwash.config import read_drone_config
    from upwash.flying import fly_with_progress

    config = read_drone_config(options.config)
    if options.autopilot:
        autopilot = msgspec.structs.replace(config.autopilot, connection=options.autopilot)
        config = msgspec.structs.replace(config, autopilot=autopilot)
    log = options.log or _run_folder() / "events.jsonl"
    fly_with_progress(config, program=options.mission, log=log)
    return _OK


def _serve(options: argparse.Namespace) -> int:
    os.environ.setdefault("GRPC_VERBOSITY", "INFO")  # gRPC then says whose certificate it refused, and why
    import logging

    from upwash.config import read_daemon_config
    from upwash.launch import serve

    config = read_daemon_config(options.config)
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    names = ", ".join(identity.name for identity in config.identities)
    asyncio.run(serve(config, ready=lambda address: _announce(f"{names} ready at {address}")))
    return _OK


def _keys(options: argparse.Namespace) -> int:
    from upwash.real.credentials import make_keys

    if not options.server and not options.drone:
        raise UsageError("nothing to make: name at least one --server or --drone")
    servers = [names.split(",") for names in options.server]
    for file in make_keys(options.folder, servers=servers, drones=options.drone):
        _announce(str(file))
    return _OK


def _vehicle(options: argparse.Namespace) -> int:
    from upwash.core.geo import GeoPosition
    from upwash.launch import run_vehicle
    from upwash.vehicle import VehicleSettings, read_fault

    settings = VehicleSettings(
        home=GeoPosition(*options.home),
        acceleration_m_s2=options.acceleration,
        armable_after_s=options.armable_after,
        battery_percent=options.battery,
        speedup=options.speedup,
        faults=tuple(read_fault(text) for text in options.faults),
    )
    asyncio.run(
        run_vehicle(options.listen, settings, ready=lambda address: _announce(f"vehicle ready at {address}"))
    )
    return _OK


def _demo(options: argparse.Namespace) -> int:
    os.environ.setdefault("GRPC_VERBOSITY", "ERROR")
    from upwash.demo import fly_demonstration

    fly_demonstration(options.folder or _run_folder())
    return _OK


def _simulate(options: argparse.Namespace) -> int:
    from upwash.lab.simulation import simulate_scenario

    simulate_scenario(
        options.scenario,
        policy=options.policy,
        seed=options.seed,
        as_json=options.json,
        log=options.log,
        figures=options.figures,
    )
    return _OK


def _reproduce(options: argparse.Namespace) -> int:
    from upwash.lab.reproduction import show_reproduction

    show_reproduction(seeds=options.seeds, figures=options.figures)
    return _OK


def _campaign(options: argparse.Namespace) -> int:
    from upwash.lab.campaign import in_processes, on_cluster
    from upwash.lab.campaign_display import show_campaign
    from upwash.lab.sweep import read_sweep

    sweep = read_sweep(options.scenario, options.settings, seeds=options.seeds)
    fly = on_cluster(options.cluster) if options.cluster else in_processes(options.workers)
    return _OK if show_campaign(sweep, options.out, fly=fly) else _FAILURE


def _run_folder() -> Path:
    from datetime import datetime

    name = datetime.now().astimezone().strftime("%Y-%m-%d_%H-%M-%S")
    for number in itertools.count(1):
        folder = Path("runs") / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            break
    return folder


def _announce(text: str) -> None:
    print(text, flush=True)


def _complain(error: UpwashError, code: int) -> int:
    print(f"upwash: {error}", file=sys.stderr)
    return code
