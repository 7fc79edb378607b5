"""What an image says of the service in it: the properties that packaging writes and a daemon reads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from upwash.real.lxd.engine import EngineImage

_PREFIX = "upwash."


@dataclass(frozen=True, slots=True)
class ServiceImage:
    """A service's image: the path of its class inside, the system below it, the Python that it was packaged with."""

    service: str
    program: str
    base: str
    python: str
    fingerprint: str = ""

    def properties(self) -> dict[str, str]:
        """What is written into the image; its fingerprint comes of that."""
        return {
            "description": f"{self.service}, a service of upwash",
            f"{_PREFIX}service": self.service,
            f"{_PREFIX}program": self.program,
            f"{_PREFIX}base": self.base,
            f"{_PREFIX}python": self.python,
        }


def newest_images(images: Iterable[EngineImage]) -> Mapping[str, ServiceImage]:
    """Of each service the image that was imported last, by the service's name; other people's are left aside."""
    found: dict[str, ServiceImage] = {}
    for image in sorted(images, key=lambda each: each.uploaded_at):
        said = image.properties
        names = ("service", "program", "base", "python")
        if all(_PREFIX + name in said for name in names):
            service, program, base, python = (said[_PREFIX + name] for name in names)
            found[service] = ServiceImage(service, program, base, python, image.fingerprint)
    return found
