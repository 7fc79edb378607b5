"""The evaluation of the thesis, flown again: its table, its figures, and what differs."""
