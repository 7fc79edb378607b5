"""The bundled mission, and how a configuration's names become missions and services.

`bundled` maps names to modules (`survey`, `detector`), loads a user's own by path, and checks that a service fits its
class and a mission takes a drone. Loading runs the user's code, so that any failure there is a UsageError.
"""
