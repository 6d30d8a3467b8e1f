"""``python -m sim.boards``: see :mod:`sim.boards.session`."""

import sys

from sim.boards.session import main

sys.exit(main(sys.argv[1:]))
