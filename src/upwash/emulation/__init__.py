"""The field on one machine: real programs in namespaces of their own, joined by emulated radio links.

- The command (`run.py`) starts the enclosed program (`emulate.py`) in namespaces of its own (`enclosure.py`). When
  either ends, the kernel ends everything inside.
- Every drone and server is a computer with a network namespace (`namespaces.py`, or `containers.py`). `field.py` has
  their addresses, `programs.py` their programs and configuration files.
- A radio (`radios.py`) joins them, and follows the drones' positions (`vehicles.py`) ten times a second.
- Lateness decides whether a run is valid: `request.py` has the limits, and what a scenario loses in an emulation.

Ugly: control groups outlive the enclosure, so the command removes them.
"""
