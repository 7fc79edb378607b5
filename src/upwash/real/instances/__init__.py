"""Service instances: processes, sandboxes and containers, and the line by which they are controlled."""
