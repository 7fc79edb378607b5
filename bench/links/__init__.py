"""Calls over links of long round trips, low rates, small packets and losses."""
