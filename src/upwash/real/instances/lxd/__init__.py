"""Containers of LXD or Incus."""
