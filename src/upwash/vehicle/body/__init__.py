"""What every stand-in multicopter has, whatever its autopilot."""
