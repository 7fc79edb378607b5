"""What the drone knows: the servers and their states, the delays to expect, and where servers are in range."""
