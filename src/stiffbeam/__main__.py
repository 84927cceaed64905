"""``python -m stiffbeam``."""

from .cli import main

main()
