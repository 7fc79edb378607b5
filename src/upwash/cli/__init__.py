"""The command line. Each module offers one command, by `add` (its arguments) and `run` (imported when it is run)."""
