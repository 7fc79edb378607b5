"""A multicopter that flies, obeys and speaks as an ArduCopter does (recorded from SITL, version 4.7).

- `airframe`, with `pursuit` and `ramps`: how it flies. `symmetric`: the same with a given acceleration.
- `flight`: a mode or a target draws a motion, and the time reads the motion off.
- `boot`, `failsafe`, `fence`: what it knows, says and does by itself, by the time since boot or since a fault.
- `copter`: commands, checks before arming, and what happens by itself.
- `commands`, `telemetry`, `firmware`, `dead_man`: the messages, and the one script that it runs.

Ugly: fail-safes are stories of texts at recorded times instead of models of an estimator. They replay what was seen;
an unseen mix of faults gives a plausible text at best. `armed` depends on the time: motors stop by themselves.
"""
