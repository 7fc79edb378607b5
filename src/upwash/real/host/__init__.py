"""This computer: log files, the service manager, signals and the clock."""
