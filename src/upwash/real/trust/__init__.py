"""Certificates and secrets: how they are signed and read, and which certificates are trusted.

Laws. A secret is read only from a regular file that no other user may read, and never shown. A certificate is
trusted if an authority of ours issued it, it is valid now, and it is not revoked: all three, at each new connection.
Keys are never overwritten, and files are made all or none.

- authority.py      makes keys and certificates, and revokes them: on the operator's computer
- credentials.py    reads them, and checks those of others
- secrets.py        files that others may not read

Ugly: Python's ssl reads certificates from files only, so they pass through a file in memory.
"""
