"""Things: the ports of the programs, provided by hardware, processes and the network."""
