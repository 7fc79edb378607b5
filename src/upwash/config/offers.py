"""Which services no server is believed to offer, as none has a time for their calls."""

from __future__ import annotations

from collections.abc import Iterator

from upwash.config.drone import DroneConfig, ServiceConfig


def never_offloaded(config: DroneConfig) -> Iterator[str]:
    """A sentence for each service that always runs on the drone though there are servers, and what to do about it."""
    offered = {name for server in config.servers for name in (*server.processing_s, *server.remote_call_s)}
    for service in config.services if config.servers else ():
        if service.name not in offered:
            yield (
                f"{service.name} always runs on the drone, as no [[server]] has a time for it: add what a call takes "
                f"to the servers that offer it, as in remote_call_s = {{ {service.name} = {_example(service)} }}"
            )


def _example(service: ServiceConfig) -> str:
    """Times of the right form."""
    keys = [key for key in service.local_call_s if key]
    return f"{{ {', '.join(f'{key} = 0.5' for key in keys)} }}" if keys else "0.5"
