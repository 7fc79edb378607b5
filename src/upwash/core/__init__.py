"""The core decides, and does nothing else: plain values in, plain values out.

Laws: no clock, socket, randomness, log or asyncio; time and position are arguments. Events come in, commands go out.

    geo, operation   places on the plane around home; what a call asks for
    knowledge/       what the drone knows: servers and their states, delays, ranges
    planning/        the mission ahead: legs, calls, schedules, orders
    policies/        which server, and where a call runs
    selection/       the drone's machine: `Selection` takes events and returns commands
    vehicle/         the vehicle's owner, fences and battery
    camera/          where what a photo shows lies
    admission/       the server's machine: `AdmissionController`, and what it keeps

Drive it by hand with docs/driving-the-core.md.

What is ugly: `Selection` and `AdmissionController` keep state, as a machine of values alone would copy hundreds of
servers at each event. Tests copy the machine where they need its past.
"""
