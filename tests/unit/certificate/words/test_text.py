import io
from pathlib import Path
from typing import Literal

import pytest
from rich.console import Console

from perfbound.orchestrator.certificate.words import text as summary
from perfbound.orchestrator.certificate.words.bound_text import outward
from perfbound.orchestrator.certificate.words.refutation_text import counterexample_parts
from perfbound.orchestrator.cli.result import print_files
from perfbound.orchestrator.report.collect.wording import claim_sentence
from perfbound.orchestrator.report.data.claims import assumption_row
from perfbound.orchestrator.run.display.progress import Plain
from perfbound.schemas.result.certificate import (
    Assumption,
    CampaignId,
    Certificate,
    CertificateClaim,
    CompositionTerms,
    Counterexample,
    Evidence,
    Predicate,
    ProblemResult,
    Rollouts,
    SpotCheck,
    SpotCheckedProblem,
)
from tests.facts import says


def a_certificate(*assumptions: Assumption) -> Certificate:
    problem = ProblemResult(
        name="maximum",
        objective="max over d of E[column]",
        method="paper",
        sense="max",
        bound=0.50001,
        partner=None,
        probability=0.92435,
        probabilities={"gaussian": 0.92435},
        tests=3,
        rollouts=Rollouts(nominal=0, true=3),
        stopped_by="budget",
        parameters={"alpha": 0.05},
        last_F=0.1,
    )
    claim = CertificateClaim(
        quantity="J_star",
        sense="<=",
        bound=0.50001,
        probability=0.92435,
        rule="single",
        method="paper",
        assumptions=tuple(each.id for each in assumptions),
        refuted=tuple(each.id for each in assumptions if each.status == "refuted"),
    )
    predicate = Predicate(
        question={},
        campaign=CampaignId(name="c", seed=1, config_sha256="0", system_sha256="0"),
        claims=(claim,),
        problems=(problem,),
        composition=None,
        assumptions=assumptions,
        evidence=Evidence(manifest_sha256="0", chain_head="0", rollouts=3),
        software={},
        rules=1,
    )
    return Certificate(subject=(), predicate=predicate)


def printed(certificate: Certificate, width: int = 100) -> list[str]:
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    summary.print_certificate(certificate, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_text_in_brackets_is_printed_as_it_is() -> None:
    lines = printed(a_certificate(Assumption(id="clip/maximum", status="derived", detail="in [bold] :warning: [/]")))
    assert says("\n".join(lines), "max E[column] <= 0.5001 probability 0.9243")
    assert says("\n".join(lines), "derived claim clipped (clip)")
    assert "                in [bold] :warning: [/]" in lines


def test_paths_and_log_lines_in_brackets_are_printed_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a [red] :x: b").mkdir()
    (tmp_path / "a [red] :x: b" / "certificate.json").touch()
    console = Console(file=io.StringIO(), width=40)
    print_files(Path("a [red] :x: b"), console)
    Plain(console).print_line("worker [bold]x[/] :x: ended")
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert says(text, "a [red] :x: b/certificate.json")
    assert "signed" not in text, "there is no signature"
    assert "worker [bold]x[/] :x: ended\n" in text


def test_a_robustness_has_the_unit_of_its_columns_and_a_column_none() -> None:
    about_a_column = a_certificate()
    (claim,) = about_a_column.predicate.claims
    other = claim.model_copy(update={"quantity": "robustness", "sense": ">=", "bound": 0.25})
    predicate = about_a_column.predicate.model_copy(update={"claims": (other,)})
    about_robustness = about_a_column.model_copy(update={"predicate": predicate})

    def head(certificate: Certificate, unit: str) -> str:
        console = Console(file=io.StringIO(), width=100)
        summary.first_claim(certificate, console, unit)
        assert isinstance(console.file, io.StringIO)
        return console.file.getvalue().splitlines()[1]

    assert says(head(about_robustness, "m"), "^CLAIM worst robustness >= 0.2500 m")
    assert head(about_robustness, "m\n[red]").endswith(r">= 0.2500 m\n[red]")
    assert head(about_robustness, "") == head(about_robustness, "1") == head(about_robustness, "m").removesuffix(" m")
    assert head(about_a_column, "m") == head(about_a_column, "")


def test_what_is_refuted_comes_first_and_marks_the_claim() -> None:
    lines = printed(
        a_certificate(
            Assumption(id="tail/maximum", status="assumed", detail="Gaussian."),
            Assumption(id="rkhs_norm/maximum", status="refuted", detail="B is wrong."),
            Assumption(id="workers_honest", status="assumed", detail="believed."),
        )
    )
    order = [
        "REFUTED, by the data of this campaign or by derivation: 1 assumption",
        "    refuted     The norm bound B is large enough for this kernel and prior mean (rkhs_norm)",
        "                B is wrong.",
        "CLAIM  J* (maximum of the expectation) <= 0.5001",
        "       REFUTED by its own data: rkhs_norm of maximum. Do not rely on it.",
        "    alpha NOT reached: its budget ended at F = 0.1000, alpha is 0.05; the bound contains the difference",
        "Assumptions that are not refuted",
        "    assumed     Large deviations are as rare as the noise model says (tail)",
        "                Gaussian.",
        "  whole campaign",
        "    assumed     Worker processes send what they simulated (workers_honest)",
        "                believed.",
    ]
    assert [line for line in lines if line in order] == order


def test_what_is_refuted_of_other_claims_comes_after_the_first_one() -> None:
    broken = Assumption(id="rkhs_norm/sim_gap", status="refuted", detail="B is wrong.")
    certificate = a_certificate(Assumption(id="tail/maximum", status="assumed", detail="Gaussian."), broken)
    first = certificate.predicate.claims[0].model_copy(update={"assumptions": ("tail/maximum",), "refuted": ()})
    other = first.model_copy(update={"assumptions": (broken.id,), "refuted": (broken.id,)})
    predicate = certificate.predicate.model_copy(update={"claims": (first, other)})
    lines = printed(certificate.model_copy(update={"predicate": predicate}))
    order = [
        "CLAIM  J* (maximum of the expectation) <= 0.5001",
        "also  J* (maximum of the expectation) <= 0.5001",
        "       REFUTED by its own data: rkhs_norm of sim_gap. Do not rely on it.",
        "REFUTED, of other claims than the first, by the data of this campaign or by derivation: 1 assumption",
        "    refuted     The norm bound B is large enough for this kernel and prior mean (rkhs_norm)",
        "                B is wrong.",
    ]
    assert [line for line in lines if line in order] == order


def test_one_line_at_a_claim_says_what_refutes_it() -> None:
    ids = ("rkhs_norm/nominal_robustness", "rkhs_norm/sim_gap", "centred_noise/sim_gap", "workers_honest")
    found = [Assumption(id=each, status="refuted", detail="why.") for each in ids]
    both = "REFUTED by its own data: rkhs_norm of nominal_robustness and sim_gap. Do not rely on it."
    certificate = a_certificate(*found[:2])
    assert f"       {both}" in printed(certificate), "it fits into the width of the lines"
    lines_of_claim = printed(certificate)[
        printed(certificate).index("CLAIM  J* (maximum of the expectation) <= 0.5001") :
    ]
    assert lines_of_claim[2] == f"       {both}", "directly behind the bound and its probability"
    assert claim_sentence(certificate.predicate.claims[0]).endswith(f". {both.removesuffix('.')}")
    lines = "\n".join(printed(a_certificate(*found)))
    assert says(
        lines, "REFUTED data: rkhs_norm nominal_robustness sim_gap workers_honest derivation: centred_noise sim_gap"
    )


def test_a_claim_without_a_refuted_assumption_is_not_marked() -> None:
    text = "\n".join(printed(a_certificate(Assumption(id="tail/maximum", status="assumed", detail="Gaussian."))))
    assert "REFUTED" not in text


@pytest.mark.parametrize("width", [80, 100, 200])
def test_long_details_hang_below_each_other(width: int) -> None:
    lines = printed(a_certificate(Assumption(id="tail/maximum", status="assumed", detail="word " * 60)), width)
    body = [line for line in lines if "word" in line]
    assert len(body) > 3
    assert {len(line) - len(line.lstrip()) for line in body[1:]} == {body[0].index("word")}
    assert max(map(len, body)) <= min(width, 100)


@pytest.mark.parametrize(
    ("bound", "sense", "text"),
    [
        (-0.00672, ">=", "-0.0068"),
        (0.85437, ">=", "0.8543"),
        (0.42291, "<=", "0.4230"),
        (0.3, ">=", "0.3000"),
        (0.3, "<=", "0.3000"),
        (-0.1 - 0.2, ">=", "-0.3000"),
    ],
)
def test_what_is_printed_promises_no_more_than_the_certificate(bound: float, sense: str, text: str) -> None:
    assert outward(bound, sense) == text


def test_the_terms_of_a_composed_claim_are_shown() -> None:
    certificate = a_certificate(Assumption(id="independence", status="derived", detail="apart."))
    claim = certificate.predicate.claims[0].model_copy(
        update={"quantity": "rho_star", "sense": ">=", "rule": "product"}
    )
    composition = CompositionTerms(
        rule="product", nominal_bound=0.45, gap_bound=0.3, lipschitz=1.0, gap_term=0.3, risk_term=0.08, bound=0.07
    )
    predicate = certificate.predicate.model_copy(update={"claims": (claim,), "composition": composition})
    lines = printed(certificate.model_copy(update={"predicate": predicate}))
    assert says("\n".join(lines), "= 0.4500 (nominal) - 0.3000 (gap) - 0.0800 (risk)")
    assert says("\n".join(lines), "least 0.9243 method paper product 1 assumption")


def test_a_term_that_is_subtracted_has_one_sign() -> None:
    certificate = a_certificate(Assumption(id="accounting", status="derived", detail="added."))
    composition = CompositionTerms(
        rule="sum", nominal_bound=-1.58, gap_bound=-1.53, lipschitz=1.0, gap_term=-1.53, risk_term=0.008, bound=-0.058
    )
    predicate = certificate.predicate.model_copy(update={"composition": composition})
    lines = printed(certificate.model_copy(update={"predicate": predicate}))
    assert says("\n".join(lines), "= -1.5800 (nominal) + 1.5300 (gap) - 0.0080 (risk)")


def changed(certificate: Certificate, **update: object) -> Certificate:
    """Return a certificate with a changed first claim and problem, and with other parts of its predicate."""
    predicate = certificate.predicate
    parts = {key: value for key, value in update.items() if key in type(predicate).model_fields}
    others = {key: value for key, value in update.items() if key not in parts}
    claims = tuple(each.model_copy(update=others) for each in predicate.claims)
    problems = tuple(each.model_copy(update=others) for each in predicate.problems)
    found = predicate.model_copy(update={"claims": claims, "problems": problems, **parts})
    return certificate.model_copy(update={"predicate": found})


def test_certainty_is_that_of_the_assumptions_and_no_number() -> None:
    """What rests on them may be false: "probability at least 1.0000" was printed beside REFUTED."""
    assumptions = [Assumption(id=name, status="assumed", detail="so.") for name in ("kernel/maximum", "clip/maximum")]
    certain = changed(a_certificate(*assumptions), probability=1.0)
    lines = printed(certain)
    assert says("\n".join(lines), "certain 2 assumptions method paper")
    assert says("\n".join(lines), "max E[column] <= 0.5001 certain")
    assert "1.0000" not in "\n".join(lines)
    (claim,) = certain.predicate.claims
    assert says(claim_sentence(claim), "0.5001 certain 2 assumptions")
    both = certain.predicate.model_copy(update={"claims": (claim, claim)})
    assert says(summary.other_claims(both, "", 3)[0], "<= 0.5001 certain 2 assumptions")


def test_a_start_has_the_names_and_units_of_its_parameters() -> None:
    detail = "at the start (55.265, 3.49781) of the spot check the value is beyond the bound 2.5."
    values: dict[str, int | float | str] = {"limit": 2.5, "start": "55.265, 3.49781"}
    given = a_certificate(Assumption(id="rkhs_norm/maximum", status="refuted", detail=detail, values=values))
    console = Console(file=io.StringIO(), width=200)
    summary.print_certificate(given, console, units={"temp": "K", "load": "1"})
    assert isinstance(console.file, io.StringIO)
    assert says(console.file.getvalue(), "temp = 55.265 K load = 3.49781")
    assert given.predicate.assumptions[0].detail == detail, "the certificate keeps its bytes"
    row = assumption_row(given.predicate.assumptions[0], {"temp": "K", "load": "1"})
    assert says(row.detail, "temp = 55.265 K load = 3.49781")


def test_a_counterexample_has_the_order_and_the_units_of_the_parameters() -> None:
    """Keys of a certificate are sorted."""
    found = Counterexample(
        rollout="robustness.5.nominal.0", test=5, rollouts=1, start={"load": 3.1, "temp": 55.4}, seed=7, robustness=-0.5
    )
    words = "; ".join(counterexample_parts(found, "N", {"temp": "K", "load": "kg"}))
    assert says(words, "-0.5000 N temp = 55.4 K load = 3.1 kg seed 7")


@pytest.mark.parametrize(
    ("number", "status", "words"),
    [
        (0, "not refuted", "not refuted 0 of 299 fresh beyond most 4.3523 %"),
        (1, "refuted", "REFUTED 1 of 299 fresh beyond most 4.3523 %"),
    ],
)
def test_the_spot_check_has_whole_sentences(number: int, status: Literal["refuted", "not refuted"], words: str) -> None:
    problem = SpotCheckedProblem(
        name="robustness", status=status, limit=2.5, noisy=False, rollouts=299, violations=number,
        violated_share=0.0435222, start=None, wealth=None, undecided=None,
    )  # fmt: skip
    spot = SpotCheck(
        starts=299, rollouts=Rollouts(nominal=299, true=0), level=0.05, failures=None, failure_probability=None,
        most_starts=None, problems=(problem,),
    )  # fmt: skip
    _, sentence = summary.check_sentences(changed(a_certificate(), spot_check=spot).predicate)
    assert says(sentence, f"^Bound robustness: {words}")
