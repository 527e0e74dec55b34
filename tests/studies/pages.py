"""The generated parts of a page: each is between two lines of it, its marks."""

from pathlib import Path


class PageError(ValueError):
    """The page cannot be written, or lacks what is read from it."""


def page_text(page: Path, *marks: tuple[str, str]) -> str:
    """Return the text of a page with these marks.

    Raises:
        PageError: the page cannot be read, or lacks the marks.

    """
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise PageError(f"{page}: {error.strerror}; give --write an existing page") from error
    for begin, end in marks:
        if begin not in text or end not in text:
            raise PageError(f"{page} has no lines '{begin}' and '{end}': put them where the table belongs")
    return text


def with_part(text: str, begin: str, end: str, part: str) -> str:
    """Return the text of a page with another part, which has its marks.

    >>> with_part("a [old] b", "[", "]", "[new]")
    'a [new] b'
    """
    return text.split(begin, maxsplit=1)[0] + part + text.split(end)[1]
