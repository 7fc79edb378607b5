"""Many simulated missions: campaigns over seeds and settings, and policies compared."""
