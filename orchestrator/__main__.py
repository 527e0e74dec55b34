"""`python -m perfbound.orchestrator`: the command `perfbound`."""

from .cli import main

main()
