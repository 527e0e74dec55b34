"""The folder of a user's keys, and whether a folder belongs to a git work tree, from which a key may be published."""

import os
from collections.abc import Mapping
from pathlib import Path

from ....schemas.errors import SignatureError


def key_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of this user's keys: `perfbound/keys` in the folder for configurations.

    Raises:
        SignatureError: this user has no home directory.

    """
    try:
        # The XDG specification has relative paths ignored.
        given = Path(environment.get("XDG_CONFIG_HOME", ""))
        folder = given if given.is_absolute() else Path.home() / ".config"
    except RuntimeError:
        raise SignatureError("this user has no home directory for a key; choose a folder with --out") from None
    return folder / "perfbound" / "keys"


def made_key_folder() -> Path:
    """Return the folder of this user's keys, which no other user can open if it is new.

    Raises:
        SignatureError: it cannot be made.

    """
    folder = key_folder()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    except OSError as error:
        raise SignatureError(f"{folder}: cannot be made ({error.strerror}); choose a folder with --out") from None
    return folder


def work_tree(folder: Path) -> Path | None:
    """Return the git work tree that a folder belongs to; None outside of any."""
    # No git is started: it may be missing, and the folders show it as well.
    inside = folder.resolve()
    # A file in a submodule and in a second work tree.
    return next((each for each in (inside, *inside.parents) if (each / ".git").exists()), None)
