"""The field on one machine: real programs in namespaces of their own, joined by emulated radio links."""
