"""Runs a drone's heavy computations on the drone or on an edge server, without the mission knowing."""
