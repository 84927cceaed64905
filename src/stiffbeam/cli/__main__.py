"""``python -m stiffbeam.cli``."""

from . import main

main()
