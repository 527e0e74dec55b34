"""`python -m tests.texts`: write every file of texts anew; their difference is then reviewed."""

import sys

from tests.texts import FOLDER, written
from tests.texts.subjects import SUBJECTS

for path in FOLDER.glob("*.txt"):
    if path.stem not in SUBJECTS:
        path.unlink()
for name, subject in SUBJECTS.items():
    path, text = FOLDER / f"{name}.txt", written(subject)
    if not path.exists() or path.read_text() != text:
        path.write_text(text)
        sys.stdout.write(f"{path.relative_to(FOLDER.parents[1])}: written anew\n")
