"""What event logs tell: a page for people, and files for other tools."""
