"""The whole reproduction: campaigns, then tables, then figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ....schemas import atomic
from ...run import session
from ...store import read
from . import figures, study, table


def reproduce(extent: study.Extent, folder: Path, out: Path, *, workers: int, console: Console) -> Iterator[str]:
    """Run what is missing of the study, write tables and figures into `out`, and yield the tables.

    Raises:
        PerfboundError, CampaignError: what is wrong, in one line.
        OSError: `out` cannot be written.
        Stopped: a signal arrived.

    """
    campaigns = study.plan(extent, folder, out)
    study.check_stored(campaigns)
    with study.following(console, len(campaigns)) as follower:
        study.conduct(campaigns, workers=workers, follower=follower)
    documents = {**_tables(campaigns), **_figure_2(campaigns), **_figure_4(campaigns)}
    out.mkdir(parents=True, exist_ok=True)
    for name, content in documents.items():
        atomic.write(out / name, content)
    console.print(Text(f"written into {out}: {', '.join(documents)}"), soft_wrap=True)
    yield "Table I\n\n" + documents["table1.md"].decode()
    yield "Claims about the true Segway\n\n" + documents["claims.md"].decode().rstrip("\n")


def _tables(campaigns: Sequence[study.Planned]) -> dict[str, bytes]:
    finished = [table.Finished(each.preset.name, session.certificate(each.directory).predicate) for each in campaigns]
    rows, claims = table.rows(finished), table.claims(finished)
    return {
        "table1.csv": table.table_csv(rows).encode(),
        "table1.md": table.table_markdown(rows).encode(),
        "claims.csv": table.claims_csv(claims).encode(),
        "claims.md": table.claims_markdown(claims).encode(),
    }


def _figure_2(campaigns: Sequence[study.Planned]) -> dict[str, bytes]:
    found = _decay(campaigns, study.FUNCTION, "maximum")
    if found is None:
        return {}
    figure = figures.figure_2(found)
    return {"figure2.png": figures.png(figure), "figure2.csv": figures.figure_2_csv(found).encode()}


def _figure_4(campaigns: Sequence[study.Planned]) -> dict[str, bytes]:
    wanted = (
        (study.DIRECT, "true_risk"),
        (study.PAPER, "nominal_robustness"),
        (study.PAPER, "sim_gap"),
    )
    decays = [found for preset, problem in wanted if (found := _decay(campaigns, preset, problem))]
    if not decays:
        return {}
    return {
        "figure4.png": figures.png(figures.figure_4(decays)),
        "figure4.csv": figures.figure_4_csv(decays).encode(),
    }


def _decay(campaigns: Sequence[study.Planned], preset: study.Preset, problem: str) -> figures.Decay | None:
    """Return the tests of one problem by seed, or None where nothing of it was run."""
    ours = [each for each in campaigns if each.preset is preset]
    if not ours:
        return None
    alpha = next(each.alpha for each in ours[0].config.problems if each.name == problem)
    return figures.Decay(problem, alpha, {each.config.seed: read.history(each.directory)[problem] for each in ours})
