"""How the command of a study ends."""

import sys
from collections.abc import Callable


def ended(main: Callable[[], int], refusal: type[Exception]) -> int:
    """Return the exit code of a command, after a line on an error of the user or an interrupt."""
    try:
        return main()
    except refusal as error:
        sys.stderr.write(f"{error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("stopped; the same command continues\n")
        return 130
