"""Cameras: the files of a folder, video devices and streams."""
