"""Drawn worlds with faults, and the promises that every flight in them keeps (docs/promises.md).

- A seed is a world: `worlds.py` draws a scenario, flies it calm, and aims faults at moments of that flight.
- `mission.py` has the missions, which know the answer of every call.
- A check yields what breaks its promise, the first breach first. It reads a `History`: the drone's log, what an
  observer saw, and the same mission without servers. The checks stand in files by what they are about;
  `promises.py` lists them.
- `campaign.py` flies and judges a world, `display.py` many of them.

Ugly: each feature draws from a stream of its own name, since a draw from a shared stream would change all worlds.
"""
