"""Configuration: TOML files become frozen values, or a ConfigError that names file, key and remedy.

A file is read in this order: `reading` (TOML to plain values), `shorthand` (short forms written out), `convert` (the
types of `values`, `drone`, `world`, `daemon` and `runtime`), `checks` (what no type says). The first problem is
raised. After that every value is possible, and `places`, `flight_times` and `truth` answer what follows from several
keys.

Nothing is imported here: a daemon reads its file without the drone's types, and loads no part of the drone's program.

A docstring below a key is its line in docs/configuration-reference.md, and the description of a kind of value is what
an error says was expected: both are for people who write files. Ugly is that msgspec names a wrong value by a path in
its message, which `explanation` has to take apart.
"""
