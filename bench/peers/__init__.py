"""upwash beside simple alternatives when a server fails: `python -m bench.peers`, see docs/peers.md.

The alternatives run in an environment of their own (`make bench-peers`): what they need is neither the product's nor
its tests'. `computation`, `telling`, `calls`, `server` and `drone` are used in both environments: Python is enough.
"""
