"""The command line: one module a command, with a table of its `ARGUMENTS` and `run` for its work.

`main` lists the commands and imports the module of the command that was typed. It turns the end of a command into an
exit code: 1 if `run` returns False, others for errors (`exit_codes`), else 0. A command raises UpwashError for a
problem that a person can solve, and prints no error itself. `arguments` has the options that several commands share.
A package of an extra is imported inside `extra(...)`, which names the extra to install.

Commands print; they decide nothing. The rooms below do the work, except for `demo`: `demonstration` and
`demonstration_fleet` start the other commands as processes, and belong here for that. Ugly is that `fly` imports what
draws only inside functions: an unwatched flight on a small computer saves 1.9 MB.
"""
