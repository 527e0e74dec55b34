"""The code of a page or a notebook, run in one process, as notebooks do.

python -m tests.end_to_end.methods.cells FILE
"""

import json
import linecache
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl

BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)


def cells(path: Path) -> Iterator[str]:
    """Yield the Python blocks of a page, or the code cells of a notebook."""
    if path.suffix == ".ipynb":
        for cell in json.loads(path.read_text())["cells"]:
            if cell["cell_type"] == "code":
                yield "".join(cell["source"])
        return
    yield from BLOCK.findall(path.read_text())


def run(path: Path) -> None:
    """Run the cells in their order, each under a name of its own and with its text, which no file has."""
    mpl.use("Agg")
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, code in enumerate(cells(path)):
        name = f"<cell {number}>"
        linecache.cache[name] = (len(code), None, code.splitlines(keepends=True), name)
        exec(compile(code, name, "exec"), names)


if __name__ == "__main__":
    run(Path(sys.argv[1]))
