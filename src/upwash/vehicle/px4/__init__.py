"""A PX4 multicopter as a program sees it: how it flies, what it does when told, what it says."""
