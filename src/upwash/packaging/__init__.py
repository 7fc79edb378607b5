"""Images of services: one file with everything that a service needs, made here and run in a container elsewhere."""
