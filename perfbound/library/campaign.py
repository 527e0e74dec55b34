"""A campaign from Python: the keys of a campaign file as arguments, checked by the parser of that file."""

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..orchestrator.campaign.checks import check_new
from ..schemas import atomic
from ..schemas.errors import CampaignError
from ..schemas.file.config import CampaignConfig
from ..schemas.file.reader import load_campaign, parse_campaign
from .system_argument import GivenSystem, given_system

if TYPE_CHECKING:
    from .run import Run
    from .study import Study
from pathlib import PurePath

from ..schemas.file.toml_text import toml_file


class Campaign:
    """A test campaign: what is tested, from which starts, against which specification, by which method.

    `system` is a function under `@perfbound.system`, the name of an installed system, "FILE.py:NAME" or a `Rig`;
    `options` are its options. All other arguments are the keys of a campaign file: see the reference. `space` maps
    each parameter to (low, high), or lists the starts, (n, d). Without `problems` there is one, `robustness`, by method
    `rigorous` on a box and `scenario` on a list, and its keys (`alpha`, `delta`, `rkhs_norm`, `kernel`, ...) are
    arguments too. `name` is by default that of the system, `seed` 1.

    Raises:
        CampaignError: one line with the key and the allowed values, as for a campaign file.

    """

    def __init__(
        self,
        system: object,
        *,
        space: Mapping[str, Any] | Sequence[Sequence[float]],
        options: Mapping[str, Any] | None = None,
        **keys: Any,
    ) -> None:
        where = f"Campaign({getattr(system, '__name__', None) or getattr(system, 'name', system)})"
        found = given_system(system, where)
        if not found.choice:
            raise CampaignError(f"{where}: a program is described in its campaign file; use Campaign.load for that")
        self._text = toml(_campaign_table(found, space, options or {}, keys), where)
        self._begin(found, parse_campaign(self._text.encode(), where), Path(where))

    def _begin(self, found: GivenSystem, config: CampaignConfig, source: Path) -> None:
        check_new(config, found.spec, str(source))
        self._subject, self.config, self._source = found, config, source

    @classmethod
    def load(cls, path: str | Path, **overrides: int) -> "Campaign":
        """Return the campaign of a campaign file; `overrides` replace top-level keys, such as `seed`.

        Raises:
            CampaignError: it cannot be read, or is not a campaign, or its system cannot be used.

        """
        file = Path(path)
        config = load_campaign(file, **overrides)
        campaign = cls.__new__(cls)
        campaign._begin(given_system(config.system.reference(file.absolute()), str(file)), config, file.absolute())
        campaign._text = toml(config.model_dump(mode="json", exclude_defaults=True), str(file))
        return campaign

    @property
    def name(self) -> str:
        """Name of the campaign, and of its run directory."""
        return self.config.name

    def to_toml(self) -> str:
        """Return the campaign as the text of a campaign file; the path of a system in a file is relative to it."""
        return self._text

    def save(self, path: str | Path) -> Path:
        """Write the campaign file; `perfbound run` runs it if it is beside the file of its system.

        Raises:
            CampaignError: no other process has the system: it was defined in this session, or is a rig.
            OSError: it cannot be written.

        """
        spec = self._subject.spec
        if spec.repeated != "anywhere":
            what = "is a rig" if spec.repeated == "nowhere" else "was defined in this session"
            raise CampaignError(
                f"{path}: {spec.name} {what}, so no command can run a campaign file of it; "
                + ("continue with ask_tell" if spec.repeated == "nowhere" else "put the function into a file")
            )
        atomic.write_whole(Path(path).absolute(), self._text.encode())
        return Path(path)

    def run(self, out: str | Path | None = None, *, workers: int = 2, progress: bool = True) -> "Run":
        """Run the campaign with local workers to its certificate; it takes minutes and prints its progress.

        `out` is the run directory, by default runs/NAME. A function that no other process can import runs in a child
        that is forked from this process, on one worker. An interrupt leaves a directory that `perfbound.resume`
        continues.

        Raises:
            PerfboundError: the directory is in use, or the run fails.
            KeyboardInterrupt: it was interrupted.

        """
        from .run import run_campaign  # noqa: PLC0415  (late: it loads the store)

        return run_campaign(self.config, self._source, self._subject, self._directory(out), workers, progress=progress)

    def ask_tell(self, out: str | Path | None = None) -> "Study":
        """Begin or continue this campaign in `out` without workers: its rollouts are handed in.

        Raises:
            PerfboundError: another campaign is there, or it is in use.

        """
        from .study import open_study  # noqa: PLC0415

        return open_study(self._directory(out), self.config, self._subject)

    def _directory(self, out: str | Path | None) -> Path:
        # Absolute: a later chdir must not lead to another directory.
        return (Path("runs") / self.name if out is None else Path(out)).absolute()

    def __repr__(self) -> str:
        """Name, system and specification."""
        return f"<Campaign {self.name} of {self._subject.spec.name}: {self.config.formula}>"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self._text)}</pre>"


def _campaign_table(
    found: GivenSystem, space: Any, options: Mapping[str, Any], keys: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the table of the campaign file; keys that are none are refused by its parser."""
    table = {"name": found.spec.name, **keys}
    if found.spec.repeated == "nowhere":
        table.setdefault("recheck", 0)
    table["system"] = {**found.choice, **options}
    table["space"] = space if isinstance(space, Mapping) else {"scenarios": space}
    return table


# A campaign as TOML: the one text that its parser reads, whether it came from a file or from Python


def toml(table: Mapping[str, Any], source: str) -> str:
    """Return the TOML of a table: plain values first, then a section for each table and list of tables.

    Values may be those of numpy; what is None is left out.

    Raises:
        CampaignError: a value has no form in TOML; the text names its key.

    >>> print(toml({"name": "a", "space": {"x": {"low": 0.0, "high": 1}}, "problems": [{"delta": 1e-3}]}, "here"))
    name = "a"
    <BLANKLINE>
    [space]
    x = { low = 0.0, high = 1 }
    <BLANKLINE>
    [[problems]]
    delta = 0.001
    <BLANKLINE>

    """
    return toml_file({key: _as_python(value, key, source) for key, value in table.items() if value is not None})


def _as_python(value: Any, key: str, source: str) -> Any:
    """Return a value as dict, list, text, number or bool of Python."""
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {
            str(name): _as_python(each, f"{key}.{name}", source) for name, each in value.items() if each is not None
        }
    if isinstance(value, list | tuple):
        return [_as_python(each, key, source) for each in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, str | bool | int | float):
        return value
    raise CampaignError(f"{source}: {key}: {type(value).__name__} is not allowed: give text, number, list or dict")
