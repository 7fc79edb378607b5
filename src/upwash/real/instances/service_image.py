"""What an image says of the service in it, whichever engine holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version

import msgspec

from upwash.errors import EngineError
from upwash.ports import Program
from upwash.real.instances.containers import slug

_PREFIX = "upwash."
_plain = msgspec.json.Decoder(dict[str, object])
_words = msgspec.json.Decoder(tuple[str, ...])


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
            f"{_PREFIX}command": msgspec.json.encode(self.program.command).decode(),
            f"{_PREFIX}base": self.base,
            f"{_PREFIX}python": self.python,
            f"{_PREFIX}release": self.release,
            f"{_PREFIX}methods": ",".join(sorted(self.methods)),
            f"{_PREFIX}concurrency": str(self.concurrency),
        }

    def require_release(self, remedy: str) -> None:
        """Raises EngineError, with the remedy, unless the image was made with this release of upwash."""
        own = version("upwash")
        if self.release != own:
            raise EngineError(
                f"the image of {self.service} was made with upwash {self.release}, and this is {own}: {remedy}"
            )


def reference_of(service: str) -> str:
    """The name by which Docker or Podman knows the image that is packaged of a service."""
    return f"upwash-{slug(service)}:latest"


def image_of(properties: Mapping[str, str], fingerprint: str) -> ServiceImage | None:
    """The image with these properties; None for one that is no service's, or says less than images do by now."""
    said = {name.removeprefix(_PREFIX): value for name, value in properties.items()}
    concurrency = said.get("concurrency", "")
    if not said.get("service") or not concurrency.isdecimal():
        return None
    try:
        settings = _plain.decode(said.get("settings") or "{}")
        command = _words.decode(said.get("command") or "[]")
    except msgspec.MsgspecError:
        return None
    return ServiceImage(
        said["service"],
        Program(said.get("program", ""), settings, command),
        said.get("base", ""),
        said.get("python", ""),
        said.get("release", ""),
        fingerprint,
        frozenset(filter(None, said.get("methods", "").split(","))),
        int(concurrency),
    )
