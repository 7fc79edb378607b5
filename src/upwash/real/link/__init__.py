"""Connections: gRPC links, the door with mutual TLS in front of them, and sockets given to other processes."""
