"""`python -m upwash` is the command `upwash`."""

import sys

from upwash.cli.main import main

sys.exit(main())
