"""Bundled missions."""
