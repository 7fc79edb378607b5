"""PROGRAM: the edge daemon."""
