"""The extension of a finished campaign whose budget was too small: a fact, and the certificate kept beside."""

from pathlib import Path

from rich.console import Console
from rich.text import Text

from ...schemas.errors import CampaignError
from ...schemas.result.certificate import Certificate
from ...schemas.result.facts import ExtensionFact
from ..campaign.checks import check_sizes
from ..campaign.extension import extension, extension_words, is_extension_to
from ..campaign.ledger import Ledger
from ..certificate import files
from ..store.journal import Journal
from .continuation import continue_command
from .options import RunOptions, reopened


def give_budget(directory: Path, options: RunOptions, console: Console, max_tests: int) -> None:
    """Extend the campaign in a run directory; raises as `extend_campaign`, and as a resume where it cannot continue."""
    # As every resume: where its software is missing, an extended campaign could not continue.
    with reopened(directory, options) as (journal, _):
        extended = extend_campaign(directory, journal, max_tests)
    if extended is not None:
        text = f"{extension_words(extended, max_tests)}; the files of the certificate so far are kept beside"
        console.print(Text(f"{directory}: {text}"), soft_wrap=True)


def extend_campaign(directory: Path, journal: Journal, max_tests: int) -> ExtensionFact | None:
    """Give a finished campaign a larger budget, and return the fact; None if it has this one, and has not ended since.

    What its closing checks found tested the bounds of before: the extended campaign ends with new ones, of starts that
    nothing has been computed from.

    Raises:
        CampaignError: it has not finished, or the extension would not be valid.
        OSError: the disk is full.

    """
    certificate, ledger = files.read(directory), Ledger(directory, journal)
    ledger.replay()
    if certificate is None:
        # The same command again, after a crash or Ctrl-C.
        if ledger.extensions and is_extension_to(ledger.extensions[-1], ledger.accounts, max_tests):
            return None
        raise CampaignError(
            f"{directory}: a larger budget is for a campaign that has finished; continue this one with "
            f"`{continue_command(directory)}`"
        )
    if not ledger.done:
        raise CampaignError(f"{directory}: has a certificate, but its tests have not ended; restore it from a copy")
    try:
        fact = extension(ledger.accounts, ledger.closing, len(ledger.extensions) + 1, max_tests)
        check_sizes(ledger.config, f"--max-tests {max_tests}", dict(fact.budgets))
    except CampaignError as error:
        raise CampaignError(f"{directory}: cannot be extended: {error}") from None
    _refuse_refuted(directory, certificate)
    # The fact comes last: without it a resume issues the same certificate again, after it nothing shows the old one as
    # that of this campaign.
    files.withdraw(directory, fact.number)
    with ledger.transaction():
        ledger.extend(fact)
    return fact


def _refuse_refuted(directory: Path, certificate: Certificate) -> None:
    refuted = sorted({name for claim in certificate.predicate.claims for name in claim.refuted})
    if refuted:
        raise CampaignError(
            f"{directory}: cannot be extended: the certificate refutes {', '.join(refuted)}, and more tests do not "
            "change that; start a new campaign that does not assume it"
        )
