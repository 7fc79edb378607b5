"""`python -m upwash`, and the command `upwash`."""

import sys


def main() -> int:
    """Runs the command line; a Ctrl-C that comes while it is still being imported ends it without a word."""
    try:
        from upwash.cli.main import main as run
    except KeyboardInterrupt:
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
