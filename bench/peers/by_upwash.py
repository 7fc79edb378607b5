"""upwash: the service, and a mission that calls it from the ground, in range of its server all the time."""

from __future__ import annotations

import os

from bench.peers.calls import make_calls
from bench.peers.computation import ON_SERVER_S, on_drone, on_server

from upwash import Drone, service


@service
class Looker:
    """Its settings say where it runs; on the drone its configured pace makes it as slow as the drone is."""

    def __init__(self, place: str, folder: str) -> None:
        self._place = place
        self._folder = folder

    def look(self, photo: bytes) -> str:
        """Where it was computed."""
        if self._place == "server":
            return on_server(self._folder, photo)
        return on_drone(self._folder, ON_SERVER_S, photo)


def mission(drone: Drone) -> None:
    """Makes the calls."""
    looker = drone.service(Looker)
    photo = drone.camera.take_photo()
    make_calls(looker.look, photo, folder=os.environ["PEERS_FOLDER"], calls=int(os.environ["PEERS_CALLS"]))
