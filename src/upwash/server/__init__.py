"""The edge daemon as a program: it carries out what `core.admission` decides, on the real world or on a model.

The laws: the core decides, and this room only translates requests, commands and the ends of instances. Each instance
has one task for its life, from its start to its end, and nothing else ends it. A defect in a life ends the daemon:
its state is unknown then, and the service manager starts it again.
"""
