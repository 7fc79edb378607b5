"""The server's machine: which drones hold a slot of a server, and which instances run.

Laws stand at the top of admission.py; those of turns, usage and failures in turns.py, usage.py and watchdog.py.

    admission       requests of drones, peers and operators → answers and commands
    server          what one server gives: slots, instances
    leases, turns   who holds a slot and for how long; who is next
    slots           how many slots a server has, as measured
    instances       at most one instance of each service
    watchdog        when an instance is of no use, and the pause after failures
    peers           slots held for drones on their way
    usage           what drones and teams have used
    clients         who asks, and the values of the status page
    instance_gate   whom an instance answers
    limits          what an instance may use, and rates of untrusted input
"""
