"""Small helpers that any room may use: files, streams, imports by name, text."""
