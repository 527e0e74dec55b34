"""The secret that the processes of one user share: `PERFBOUND_SECRET`, else a file that only this user can read.

The file lies in the state directory, not in the runtime directory: that one ends with the last session of the user, and
a campaign continues. It is made by the first process that needs it.
"""

import os
import secrets
import stat
from collections.abc import Mapping
from pathlib import Path

from ..atomic import make_private_folder, write_new
from ..errors import SecretError

VARIABLE = "PERFBOUND_SECRET"
WEB_VARIABLE = "PERFBOUND_WEB_TOKEN"
"""Variable of the token of a live page, which is of the orchestrator alone: workers and systems never get it."""
FOLDER, FILE = "perfbound", "secret"
LEAST, MOST = 16, 1000
"""Characters of a secret."""


def given_secret(environment: Mapping[str, str] = os.environ) -> bytes | None:
    """Return the secret of the environment; None if it has none.

    Raises:
        SecretError: it is too short or not one line of text.

    """
    text = environment.get(VARIABLE)
    return None if text is None else _checked(text, VARIABLE)


def user_secret(environment: Mapping[str, str] = os.environ) -> bytes:
    """Return the secret in the file of this user, which is made if it is not there.

    Raises:
        SecretError: there is no place for the file, or others could read or replace it.

    """
    path = secret_file(environment)
    try:
        check_own_folder(path.parent)
        found = _contents(path)
        if found is None:
            _make(path)
            found = _contents(path)
    except OSError as error:
        raise SecretError(
            f"{path}: the secret of this user cannot be kept there ({error.strerror}); fix the folder or set {VARIABLE}"
        ) from None
    if found is None:
        raise SecretError(f"{path}: removed while it was read; run the command again")
    return _checked(found, str(path))


def secret_file(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the place of this user's secret.

    Raises:
        SecretError: this user has no home directory.

    """
    try:
        # The XDG specification has relative paths ignored.
        state = Path(environment.get("XDG_STATE_HOME", ""))
        folder = state if state.is_absolute() else Path.home() / ".local" / "state"
    except RuntimeError:
        raise SecretError(f"this user has no home directory for a secret; set XDG_STATE_HOME or {VARIABLE}") from None
    return folder / FOLDER / FILE


def _make(path: Path) -> None:
    try:
        write_new({path: (f"{secrets.token_hex(32)}\n".encode(), 0o600)})
    except FileExistsError:
        return  # another process was first: its secret is the one


def check_own_folder(folder: Path) -> None:
    """Make the folder of the secret; refuse one in which others could put another file in the place of the secret.

    Whatever else this user keeps beside the secret is made after it: with its umask others might write in the folder.

    Raises:
        SecretError: others could.
        OSError: the folder cannot be made.

    """
    # A link is judged as one below, and refused: everyone who may change it could lead it elsewhere.
    if not folder.is_symlink():
        make_private_folder(folder)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o022:
        raise SecretError(
            f"{folder}: others could replace the secret in it; run `chmod 700` on it, or choose a folder, no symbolic "
            f"link, that belongs to this user and that no one else may write, or set {VARIABLE}"
        )


def _contents(path: Path) -> str | None:
    """Return the text of the file; None if there is none."""
    if path.is_symlink():
        raise SecretError(f"{path}: a symbolic link, no file with a secret; remove it, or set {VARIABLE}")
    try:
        # Without waiting for a writer, should it be a FIFO.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
            raise SecretError(
                f"{path}: others could know this secret; remove it, and it is made again, as a file of this user with "
                "mode 0600"
            )
        return file.read(4 * MOST).decode(errors="replace")


def _checked(text: str, where: str) -> bytes:
    text = text.strip()
    if not LEAST <= len(text) <= MOST or not text.isprintable():
        raise SecretError(
            f"{where}: a secret has {LEAST} to {MOST} printable characters; choose one with `openssl rand -hex 32`"
        )
    return text.encode()


def shared_secret(*, loopback: bool, environment: Mapping[str, str] = os.environ) -> bytes | None:
    """Return the secret of a link: the one of the environment, on loopback else that of this user, else None.

    Raises:
        SecretError: the secret cannot be used, or there is no place for one.

    """
    return given_secret(environment) or (user_secret(environment) if loopback else None)
