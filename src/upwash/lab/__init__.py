"""The laboratory: the programs on models, on virtual time."""
