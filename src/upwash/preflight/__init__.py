"""What can be known before take-off: what is covered, how long the mission takes, what may cause problems."""
