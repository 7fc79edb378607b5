"""A drone whose computer lacks something in flight, on virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.drone.test_pending import of
from tests.programs import ROOT

import upwash
from upwash.core.knowledge.supplies import Supplies
from upwash.drone.sparing import Sparing, SparingAlbum
from upwash.eventlog import schema
from upwash.ports import KeptPhoto
from upwash.real.camera.album import FolderAlbum
from upwash.sim.journal import MemoryJournal

DEMONSTRATION = ROOT / "scenarios" / "demonstration.toml"


def flown(**fault: Any) -> upwash.Simulation:
    faults = [{"target": "computer", **fault}] if fault else []
    return upwash.simulate(DEMONSTRATION, policy="location-aware", overrides={"fault": faults})


@pytest.mark.parametrize("kind", ["files", "threads", "memory"])
def test_no_server_is_dialled_while_that_is_scarce(kind: str) -> None:
    usual = flown()
    joined = of(list(usual.events), schema.Joined)
    from_s, to_s = joined[0].t - 1.0, joined[0].t + 20.0
    run = flown(kind=kind, from_s=from_s, to_s=to_s)
    changes = of(list(run.events), schema.SupplyChanged)
    assert [(each.supply, each.scarce) for each in changes] == [(kind, True), (kind, False)]
    assert run.completed and not run.offloading_failed and len(run.calls) == len(usual.calls)
    ready = [step.t for step in of(list(run.events), schema.ServerStep) if step.after == "READY"]
    assert ready and min(ready) > changes[1].t
    refused = [step.why for step in of(list(run.events), schema.ServerStep) if "is not dialled" in step.why]
    assert refused


def test_a_disk_that_is_nearly_full_costs_no_server() -> None:
    usual, run = flown(), flown(kind="disk")
    assert [each.supply for each in of(list(run.events), schema.SupplyChanged)] == ["disk"]
    assert run.calls == usual.calls


class _Filling:
    disk = 1e9

    def left(self) -> Supplies:
        return Supplies(disk=self.disk)

    async def may_have_changed(self) -> None:
        await asyncio.sleep(1.0)


def test_photos_are_kept_while_the_disk_has_room(tmp_path: Path) -> None:
    asyncio.run(_keep_photos(tmp_path))


async def _keep_photos(tmp_path: Path) -> None:
    computer, journal = _Filling(), MemoryJournal()
    journal.begin()
    album = SparingAlbum(FolderAlbum(tmp_path / "kept"), Sparing(computer, journal))
    photo = KeptPhoto(b"\xff\xd8\xff\xd9", "camera", None)
    names = []
    for computer.disk in (1e9, 1e6, 1e9):
        names.append(await album.keep(photo))
    assert names == ["00001.jpg", "camera", "00002.jpg"]
    assert [each.scarce for each in of(list(journal.events), schema.SupplyChanged)] == [True, False]
