"""PROGRAM: measures what the calls of a service cost.

`profiler.py` calls every operation with photos, here in an instance of its own or at a server, and `report.py` writes
the result as tables of a configuration. The first call of an instance is kept apart from the later ones.
"""
