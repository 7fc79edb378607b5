"""Puts the programs on `real/`: one module a program."""
