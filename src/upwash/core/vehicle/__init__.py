"""The vehicle: who controls it, where it may be, and when its battery requires the way home."""
