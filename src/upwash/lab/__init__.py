"""Puts the programs on models, on virtual time, and judges the results.

- The same scenario and seed give the same events, byte for byte, in any process.
- `run.py` makes a world: the servers (`field.py`), the drones, and observers that change nothing (`observer.py`).
- `scenario.py` reads and changes scenarios; `simulation.py` is the public face; `outcome.py` has a flight in a few
  numbers, `bounds.py` the least time that any policy could need.
- Other rooms stand on this one: `figures/` draws, `reproduction/` flies the thesis's experiments, `campaigns/` flies
  many missions and compares policies, `faults/` draws worlds with faults and judges the promises.

Ugly: `bounds.py` reads the log a second time, as the bound needs what a run does not keep.
"""
