"""The policies: which server to select, and whether a call waits, runs remotely or locally."""
