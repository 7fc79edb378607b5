"""The commands: each module offers one, by `add` (its arguments) and `run` (one call, imported when it is run)."""
