"""Certificates and secrets: who signs them, who reads them, and which certificates are trusted."""
