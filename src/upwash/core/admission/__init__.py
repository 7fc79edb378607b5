"""The server-side machine: which drones hold a slot of a server, and which instances run."""
