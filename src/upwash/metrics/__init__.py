"""What drones and daemons offer to Prometheus, where the configuration says so; the names are in docs/metrics.md."""
