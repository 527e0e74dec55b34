"""Write the diagrams to docs/images; a test keeps them current."""

from tests.architecture.diagrams import FOLDER, texts

for name, text in texts().items():
    (FOLDER / name).write_text(text)
