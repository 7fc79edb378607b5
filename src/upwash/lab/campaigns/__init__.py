"""Many simulated missions: campaigns over seeds and settings, and policies compared.

- A sweep is every combination of settings with every seed; `sweep.py` reads it.
- A campaign flies it in chunks on this machine or a cluster (`campaign.py`). Each chunk is on disk before the next is
  asked for, so an interrupted campaign continues (`file.py`).
- `comparison.py` flies every policy in every scenario with the same seeds, and pairs them by seed.
- `display.py` prints and draws a campaign.
"""
