"""Models: the ports of the programs, computed instead of provided by things."""
