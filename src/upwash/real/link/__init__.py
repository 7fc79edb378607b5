"""Calls between programs: gRPC links, the door with mutual TLS before them, and socket pairs to own instances.

Laws. A peer is a stranger until its certificate is checked; strangers are bounded in connections, handshakes, bytes
and time. A known caller is bounded in connections, requests and frames. A request is bounded in size, in number and
by its deadline, and cancelling it ends it at the other end. The daemon's key stays in the door: gRPC and services
never hold it.

- link.py, way.py     a drone's end of gRPC, and measurements of the network path to a server
- listener.py         the server's end of gRPC
- direct.py           both ends of calls over a socket pair
- requests.py         handles requests, for both listeners
- door.py, tls.py     accepts, checks certificates, and hands the bytes on
- limits.py           the door's bounds
- proxy.py            passes connections from a door into an instance, with the caller's name
- streams.py          connections of bytes, and sockets that listen
- hand_over.py        gives the listening socket to the next daemon
- orders.py           what an operator of the same machine orders

Ugly: gRPC for Python does not show the peer's certificate or the end of a handshake, and does not end a request
whose peer reads nothing. So TLS ends in the door, callers are known by the address of a unix socket, and the link
keeps deadlines itself.
"""
