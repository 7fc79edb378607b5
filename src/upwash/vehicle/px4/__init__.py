"""A multicopter that flies, obeys and speaks as a PX4 does on an onboard link (recorded from SIH, version 1.16.1).

- `body`: a point under drag with PX4's speed controllers, in steps of 50 ms. `airframe`: whole flights in advance.
- `navigator`, `inputs`, `flight`: where it flies by itself, by setpoints or by sticks, and how it meets the ground.
- `failsafe`: causes, actions and their order of severity; `vehicle`: modes, arming, and the dangers that it watches.
- `commands`, `telemetry`, `firmware`: the messages. PX4 speaks in numbered events, and tells some as texts too.

A mode is intended by a command and chosen by the fail-safe: `intended` and `mode` differ while one acts.

Ugly: summaries of the checks are recorded bit patterns; only two states are known. `inputs` has GPS in it,
since both are sources that may be lost.
"""
