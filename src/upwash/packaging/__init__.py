"""Images of services: one file with all that a service needs, made here and run in a container elsewhere.

The laws: the same inputs give the same file, byte for byte, so `image` fixes times, owners and order. An image has
nothing that was not named: links that lead elsewhere, devices and too many files are refused (`contents`). Nothing is
downloaded, except by debootstrap (`base`). `shipping` passes images to an engine, and lists what a daemon has.

What is ugly: a base `host` borrows /usr of the machine where the container runs, which must be the same Debian.
"""
