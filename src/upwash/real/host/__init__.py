"""What a program has to do with its computer: clock, logs, signals and the service manager.

Laws. The event log has whole lines only, in their order, and a full disk does not end a flight. The clock is set
only where nothing else keeps it, and never to a time that makes other certificates valid. A log takes a bounded
number of lines of each kind, each on one line. The second signal ends what the first could not.

- journal.py           the event log
- log.py               a program's log on standard error
- clock.py             the computer's clock, set by GPS
- signals.py           SIGINT, SIGTERM, SIGHUP
- scratch.py           a folder for sockets, and what killed programs left
- service_manager.py   sd_notify(3)

Ugly: libraries write to file descriptor 2 past Python, so a log in JSON reads that back through a pipe.
"""
