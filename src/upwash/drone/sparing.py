"""What is scarce on the drone's computer is spared for the flight: new links and details go first.

Open files, threads and memory: no server is dialled, and each call runs on the drone. Disk: no photo is kept, and the
drone's position is logged less often. The flight goes on in any case.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

from upwash.core.knowledge.supplies import FOR_LINKS, Scarcity, Supply
from upwash.errors import Unreachable
from upwash.eventlog import schema
from upwash.eventlog.notices import left_of
from upwash.ports import Album, Computer, Dialer, Journal, KeptPhoto, Link
from upwash.support.background import never

_MOST = 10**12  # that the log has


class Sparing:
    """Watches the supplies of the program's computer, and tells and spares what is scarce."""

    def __init__(self, computer: Computer | None, journal: Journal) -> None:
        self._computer = computer  # without a computer no supply is scarce
        self._journal = journal
        self._scarcity = Scarcity()

    async def watch(self) -> NoReturn:
        """Look again and again, until cancelled."""
        while self._computer is not None:
            self._look()
            await self._computer.may_have_changed()
        await never()

    @property
    def spares_disk(self) -> bool:
        """Whether only what matters most is written."""
        return "disk" in self._scarcity.scarce

    def why_not(self, *needed: Supply) -> str:
        """Which of the supplies is scarce now, in words; "" for none."""
        self._look()
        scarce = self._scarcity.scarce
        return next((left_of(supply, scarce[supply]) for supply in needed if supply in scarce), "")

    def _look(self) -> None:
        for change in self._scarcity.look(self._computer.left()) if self._computer is not None else ():
            left = int(min(change.left, _MOST))
            self._journal.record(schema.SupplyChanged(supply=change.supply, left=left, scarce=change.scarce))


@dataclass(frozen=True, slots=True)
class SparingDialer:
    """Opens links by another dialer while the program has what a link needs."""

    dialer: Dialer
    sparing: Sparing

    def dial(self, address: str, *, server: str) -> Link:
        """A link as by the other dialer; raises Unreachable while a supply is scarce."""
        if why := self.sparing.why_not(*FOR_LINKS):
            raise Unreachable(f"{server} is not dialled: this computer has {why}")
        return self.dialer.dial(address, server=server)


@dataclass(frozen=True, slots=True)
class SparingAlbum:
    """Keeps photos in another album while the disk has room, and the program has files and threads."""

    album: Album
    sparing: Sparing

    async def keep(self, photo: KeptPhoto) -> str:
        """Returns the photo's name in the other album, or its source while a supply is scarce; raises NotWritten."""
        if self.sparing.why_not("disk", "files", "threads"):
            return photo.source
        return await self.album.keep(photo)
