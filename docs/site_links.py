"""Hook of the docs site: files of the repository that a page links to, copied into the site under `repository/`."""

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"(?<=\]\()[^)#:\s]+")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Return the files of the site, with every linked file of the repository."""
    pages = list(files.documentation_pages())
    while pages:
        for path in _linked(pages.pop()):
            if files.get_file_from_path(_on_site(path)) is None and (ROOT / path).is_file():
                added = File.generated(config, _on_site(path), abs_src_path=str(ROOT / path))
                files.append(added)
                if added.is_documentation_page():
                    pages.append(added)
    return files


def on_page_markdown(markdown: str, *, page: Page, **_: object) -> str:
    """Return the text of a page with its links as paths within the site."""
    return LINK.sub(lambda link: _relative(_path(page.file, link[0]), page.file), markdown)


def _linked(file: File) -> Iterator[str]:
    for link in LINK.findall(file.content_string):
        yield _path(file, link)


def _path(file: File, link: str) -> str:
    """Return the path in the repository that a link of a page means."""
    source = Path(str(file.abs_src_path)).relative_to(ROOT).as_posix()
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def _on_site(path: str) -> str:
    return path.removeprefix("docs/") if path.startswith("docs/") else f"repository/{path}"


def _relative(path: str, file: File) -> str:
    return posixpath.relpath(_on_site(path), posixpath.dirname(file.src_uri) or ".")
