"""The bundled mission, and how a configuration's names become missions and services.

`program` finds missions and `bundled` services: by a name that is bundled (`survey`, `detector`), or a user's own by
its path. A service has to fit its class, and a mission has to take a drone. Loading runs the user's code, so that any
failure there is a UsageError. A daemon loads services alone, and nothing of the drone's program.
"""
