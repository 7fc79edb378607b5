"""The mission ahead: the calls to come, when they come, and the best schedule of servers for them."""
