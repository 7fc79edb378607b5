"""How a call is declared, encoded, bounded and addressed.

Laws. A call's arguments and its result are built and checked by the type hints of its method, at both ends. A
message is bounded before it is decoded: its values and texts are counted by their headers. Nothing that arrives
chooses what is imported, executed or written to a log unescaped. Both ends tolerate fields of replies that they do
not know.

- service.py      @service and @once, stubs, and each method's request and reply
- operations.py   which methods of a class are operations
- settings.py     parameters of a service's constructor, from a configuration
- wire.py         types that can be sent, MessagePack, and the bounds of a message
- arrays.py       numpy's arrays in messages
- protocol.py     messages between drones and daemons

Ugly: an exception travels with the path of its class, and is made again without its constructor, which may need
other arguments than an exception keeps.
"""
