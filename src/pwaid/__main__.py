"""`python -m pwaid` is the command `pwaid`."""

import sys

from pwaid.cli import main

sys.exit(main())
