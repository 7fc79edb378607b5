"""Servers' networks: NetworkManager, connection profiles and the discovery of servers."""
