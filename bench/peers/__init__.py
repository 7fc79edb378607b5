"""upwash beside simple alternatives when a server fails: `python -m bench.peers`, see docs/science.md.

The alternatives run in an environment of their own (`make bench-peers`). The product and its tests need none of them.
`computation`, `telling`, `calls`, `server` and `drone` are used in both environments: Python is enough.
"""
