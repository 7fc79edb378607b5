"""What an image says of the service in it: the properties that packaging writes and a daemon reads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import msgspec

from upwash.ports import Program
from upwash.real.lxd.engine import EngineImage

_PREFIX = "upwash."
_NAMES = ("service", "program", "settings", "base", "python", "release", "methods", "concurrency")
_plain = msgspec.json.Decoder(dict[str, object])


@dataclass(frozen=True, slots=True)
class ServiceImage:
    """A service's image: its program, the system below it, the Python and upwash that it was packaged with.

    `methods` are those that the service declares, `concurrency` how many calls an instance computes at a time, in the
    words of whoever packaged it.
    """

    service: str
    program: Program
    base: str
    python: str
    release: str
    fingerprint: str = ""
    methods: frozenset[str] = frozenset()
    concurrency: int = 1

    def properties(self) -> dict[str, str]:
        """What is written into the image; its fingerprint comes of that."""
        return {
            "description": f"{self.service}, a service of upwash",
            f"{_PREFIX}service": self.service,
            f"{_PREFIX}program": self.program.path,
            f"{_PREFIX}settings": msgspec.json.encode(self.program.settings, order="sorted").decode(),
            f"{_PREFIX}base": self.base,
            f"{_PREFIX}python": self.python,
            f"{_PREFIX}release": self.release,
            f"{_PREFIX}methods": ",".join(sorted(self.methods)),
            f"{_PREFIX}concurrency": str(self.concurrency),
        }


def newest_images(images: Iterable[EngineImage]) -> Mapping[str, ServiceImage]:
    """Of each service the image that was imported last, by the service's name; other people's are left aside."""
    found: dict[str, ServiceImage] = {}
    for image in sorted(images, key=lambda each: each.uploaded_at):
        said = {name: image.properties.get(_PREFIX + name, "") for name in _NAMES}
        if said["service"] and said["concurrency"].isdecimal():  # else it says less than images do by now
            found[said["service"]] = ServiceImage(
                said["service"],
                Program(said["program"], _plain.decode(said["settings"])),
                said["base"],
                said["python"],
                said["release"],
                image.fingerprint,
                frozenset(filter(None, said["methods"].split(","))),
                int(said["concurrency"]),
            )
    return found
