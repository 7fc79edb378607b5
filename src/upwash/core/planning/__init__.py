"""The mission ahead: the calls to come, when they come, and the best schedule of servers for them.

Laws:
- every coming stop is expected to be like the last one: the same calls after the same pauses;
- legs are flown from rest to rest, and a vehicle's agility is learnt from its legs;
- a schedule pays for each check once, and never knows of failures.

    legs            how long the way between waypoints takes
    mission_model   follows one mission; says which calls come
    forecast        the same with the servers in range of each call
    schedule        the quickest sequence of servers
    order           the order of the waypoints
    stay_or_go      whether to fly on before an answer is there
    demand_map      the chance of a demand at a place
    acts            where an act costs least
    backlog         where a resting drone waits best for answers

What is ugly: the search of `schedule` keeps two of many sets of started services, as all of them would be too many.
"""
