"""`python -m upwash` is the command `upwash`."""

import sys

from upwash.cli import main

sys.exit(main())
