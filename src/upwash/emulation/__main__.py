"""The enclosed program of `upwash emulate`, started as `python -m upwash.emulation ORDER`."""

from __future__ import annotations

import asyncio
import sys
from functools import partial

from upwash.emulation.emulate import emulate
from upwash.emulation.enclosure import settle_in
from upwash.emulation.request import EmulationRequest
from upwash.errors import UpwashError


async def _main(request: EmulationRequest) -> None:
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    settle_in(partial(loop.call_soon_threadsafe, stop.set))
    outcome = await emulate(request, stop)
    outcome.write(request.folder)


if __name__ == "__main__":
    try:
        asyncio.run(_main(EmulationRequest.decoded(sys.argv[1])))
    except* UpwashError as errors:
        sys.stderr.write(f"upwash: {errors.exceptions[0]}\n")
        raise SystemExit(1) from None
