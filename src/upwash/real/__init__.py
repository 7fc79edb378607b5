"""Things: the ports of the programs, provided by hardware, processes and the network."""

import os

# Before gRPC is imported: its handlers of a fork start threads in the new process before that runs another program,
# and where no thread may be started they wait for ever, and so does who wanted to run the program.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")

# Names are looked up as the system does, in what nsswitch.conf names, such as multicast DNS: gRPC's own resolver asks
# DNS servers even for what /etc/hosts has, and waits for their answer.
os.environ.setdefault("GRPC_DNS_RESOLVER", "native")
