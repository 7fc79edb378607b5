"""Measures emulated links from inside an enclosure: `python links.py RADIO FILE` writes what it saw as JSON."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.core.geo import Position
from upwash.emulation.emulate import make_radio
from upwash.emulation.enclosure import settle_in
from upwash.emulation.field import EmulatedLink, Field
from upwash.emulation.namespaces import enter, inside, make_namespace
from upwash.emulation.radios import EmulatedRadio
from upwash.emulation.request import RadioKind, emulated

SCENARIO = Path(__file__).parents[3] / "scenarios" / "demonstration.toml"
SENT_BYTES = 3_000_000
TAKES_EFFECT_S = 0.3


def main(radio_kind: RadioKind, file: Path) -> None:
    settle_in(lambda: None)
    field = Field([with_range(100.0)])
    for namespace in field.namespaces():
        make_namespace(namespace)
    with contextlib.closing(make_radio(radio_kind, field)) as radio:
        link = next(iter(field.links()))
        seen = {f"{distance_m}": measure(radio, link, distance_m) for distance_m in (50, 110, 99)}
    file.write_text(json.dumps(seen))


def with_range(range_m: float) -> DroneConfig:
    config = emulated(read_drone_config(SCENARIO))
    servers = tuple(
        msgspec.structs.replace(server, east_m=0.0, north_m=0.0, range_m=range_m) for server in config.servers
    )
    return msgspec.structs.replace(config, servers=servers)


def measure(radio: EmulatedRadio, link: EmulatedLink, distance_m: int) -> dict[str, float]:
    radio.move(link.drone, Position(distance_m, 0.0))
    time.sleep(TAKES_EFFECT_S)
    answered = subprocess.run(
        [*inside(link.drone_end.namespace), "ping", "-c3", "-i0.3", "-W1", link.server_end.address],
        stdout=subprocess.DEVNULL,
        check=False,
    )
    if answered.returncode != 0:
        return {"answers": False, "goodput_mbit_s": 0.0}
    return {"answers": True, "goodput_mbit_s": goodput_mbit_s(link)}


def goodput_mbit_s(link: EmulatedLink) -> float:
    ready, took_s = threading.Event(), []

    def receive() -> None:
        enter(link.server_end.namespace)
        with socket.create_server((link.server_end.address, 5000)) as listening:
            ready.set()
            connection, _ = listening.accept()
            with connection:
                began_s = time.monotonic()
                while connection.recv(65536):
                    pass
                took_s.append(time.monotonic() - began_s)

    def send() -> None:
        enter(link.drone_end.namespace)
        with socket.create_connection((link.server_end.address, 5000)) as connection:
            connection.sendall(bytes(SENT_BYTES))

    receiving, sending = threading.Thread(target=receive), threading.Thread(target=send)
    receiving.start()
    ready.wait()
    sending.start()
    sending.join()
    receiving.join()
    return 8e-6 * SENT_BYTES / took_s[0]


if __name__ == "__main__":
    main("ns3" if sys.argv[1] == "ns3" else "table", Path(sys.argv[2]))
