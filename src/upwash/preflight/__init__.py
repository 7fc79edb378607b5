"""What is to be known before take-off: what is covered, how long the mission will take, what will hurt."""
