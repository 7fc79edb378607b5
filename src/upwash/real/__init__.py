"""Things: the ports of the programs, provided by hardware, processes and the network."""

import os

# Before gRPC is imported: its handlers of a fork start threads in the new process before that runs another program,
# and where no thread may be started they wait for ever, and so does who wanted to run the program.
os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")
