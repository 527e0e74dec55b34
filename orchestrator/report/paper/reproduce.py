"""The whole reproduction of the paper: campaigns, then tables, then figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ....schemas import atomic
from ...run.directory import finished_certificate
from ...store import facts as recorded_facts
from .. import style
from . import figures, study, table
from .study import DIRECT, FUNCTION, PAPER, Planned, Preset


def reproduce_paper(extent: study.Extent, folder: Path, out: Path, *, workers: int, console: Console) -> Iterator[str]:
    """Run the unfinished campaigns of the study, write tables and figures into `out`, and yield the tables.

    Raises:
        PerfboundError, CampaignError: a campaign fails, or its file is wrong; the text has one line.
        OSError: `out` cannot be written.
        Stopped: a signal arrived.

    """
    campaigns = study.planned(extent, folder, out)
    study.check_stored(campaigns)
    study.run_unfinished(campaigns, workers=workers, console=console)
    documents = {**_tables(campaigns), **_figure_2(campaigns), **_figure_4(campaigns)}
    out.mkdir(parents=True, exist_ok=True)
    for name, content in documents.items():
        atomic.write_whole(out / name, content)
    console.print(Text(f"written into {out}: {', '.join(documents)}"), soft_wrap=True)
    yield "Table I\n\n" + documents["table1.md"].decode()
    yield "Claims about the true Segway\n\n" + documents["claims.md"].decode().rstrip("\n")


def _tables(campaigns: Sequence[Planned]) -> dict[str, bytes]:
    finished = [table.Finished(each.preset.name, finished_certificate(each.directory).predicate) for each in campaigns]
    rows, claims = table.rows(finished), table.claim_rows(finished)
    return {
        "table1.csv": table.table_csv(rows).encode(),
        "table1.md": table.table_markdown(rows).encode(),
        "claims.csv": table.claims_csv(claims).encode(),
        "claims.md": table.claims_markdown(claims).encode(),
    }


def _figure_2(campaigns: Sequence[Planned]) -> dict[str, bytes]:
    decays = _decays(campaigns, [(FUNCTION, "maximum")])
    if not decays:
        return {}
    return {
        "figure2.png": style.png(figures.figure_2(decays[0])),
        "figure2.csv": figures.figure_2_csv(decays[0]).encode(),
    }


def _figure_4(campaigns: Sequence[Planned]) -> dict[str, bytes]:
    decays = _decays(campaigns, [(DIRECT, "true_risk"), (PAPER, "nominal_robustness"), (PAPER, "sim_gap")])
    if not decays:
        return {}
    return {
        "figure4.png": style.png(figures.figure_4(decays)),
        "figure4.csv": figures.figure_4_csv(decays).encode(),
    }


def _decays(campaigns: Sequence[Planned], wanted: Sequence[tuple[Preset, str]]) -> list[figures.Decay]:
    """Return the tests of these problems by seed, without the problems of presets that were not run."""
    found = []
    for preset, problem in wanted:
        members = [each for each in campaigns if each.preset is preset]
        if members:
            alpha = next(each.alpha for each in members[0].config.problems if each.name == problem)
            runs = {each.config.seed: recorded_facts.history(each.directory)[problem] for each in members}
            assert alpha is not None, "the presets search the worst start"
            found.append(figures.Decay(problem, alpha, runs))
    return found
