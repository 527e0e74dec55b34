"""The safety case: its numbers are those of the certificate, its argument is well formed, its document short."""

import itertools
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.assumptions.statements import STATEMENTS
from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.orchestrator.certificate.verify.checks import Check
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.certificate.words.bound_text import outward
from perfbound.orchestrator.release.safety_case.argument import Element, argument, to_yaml
from perfbound.orchestrator.release.safety_case.case import Named, SafetyCase, safety_case
from perfbound.orchestrator.release.safety_case.document import MOST_PAGES, text_pages, to_pdf, wrapped
from perfbound.orchestrator.release.safety_case.drawing import drawing, placed
from perfbound.orchestrator.release.safety_case.files import PDF, SVG, YAML, case_files
from perfbound.orchestrator.release.safety_case.judges import BY_JUDGE, OF_FORMS, judge_of
from perfbound.schemas.errors import EvidenceError
from perfbound.schemas.rollout import RolloutRequest
from tests.fakes.simulators import robustness, simulate

FIXTURES = Path(__file__).parents[3] / "fixtures" / "finished"
METHODS = ("paper", "rigorous", "kriging", "scenario", "sample")


def made(directory: Path, *signers: Path) -> SafetyCase:
    found = verify_certificate(directory, key=None, again=0, report=lambda *_: None)
    assert found.certificate is not None
    return safety_case(directory, signers, found.certificate, found.checks.lines())


@pytest.fixture(scope="module")
def cases() -> dict[str, SafetyCase]:
    """The safety cases of the finished campaigns of all methods."""
    return {name: made(FIXTURES / name) for name in METHODS}


@pytest.fixture(scope="module")
def violated(tmp_path_factory: pytest.TempPathFactory) -> SafetyCase:
    """Of a campaign with requirements, of which one is violated."""
    directory = tmp_path_factory.mktemp("case") / "violated"
    requirements = [
        {
            "name": "low",
            "formula": "value >= 0",
            "id": "REQ-1",
            "text": "The value is $never$ negative.",
            "link": "d.pdf",
        },
        {"name": "high", "formula": "value >= 0.45", "id": "REQ-2"},
    ]
    config = robustness(
        {"method": "sample"},
        name="several",
        specification=None,
        specifications=requirements,
        claims=[{"quantity": "failure_probability"}],
        max_tests=60,
        spot_check=0,
        recheck=0,
    )

    def value(request: RolloutRequest) -> float:
        return 0.6 - 0.2 * sum(request.x)

    assert simulate(directory, config, value, noisy=False)
    return made(directory)


@pytest.mark.parametrize("method", METHODS)
def test_bounds_and_probabilities_are_those_of_the_certificate(cases: dict[str, SafetyCase], method: str) -> None:
    certificate, case = files.read(FIXTURES / method), cases[method]
    assert certificate is not None
    predicate = certificate.predicate
    assert len(case.claims) == len(predicate.claims)
    for text, claim in zip(case.claims, predicate.claims, strict=True):
        bound = outward(claim.bound, claim.sense).replace("-", "−")
        assert bound in text.sentence
        assert claim.probability == 1.0 or outward(claim.probability, ">=") in text.sentence
        assert text.refuted == bool(claim.refuted)
    assert [(each.id, each.status) for each in case.assumptions] == [
        (each.id, each.status) for each in predicate.assumptions
    ]
    shown = " ".join(each.text for each in case.evidence)
    for digest in (predicate.evidence.manifest_sha256, predicate.campaign.config_sha256, case.certificate_sha256):
        assert digest in shown


def test_requirements_keep_their_ids_texts_and_links_and_the_domain_its_ranges(violated: SafetyCase) -> None:
    assert violated.requirements == (
        Named("REQ-1 (low)", "value ≥ 0"),
        Named("", "The value is $never$ negative."),
        Named("", "d.pdf"),
        Named("REQ-2 (high)", "value ≥ 0.45"),
    )
    assert violated.domain == (Named("z1", "0 to 1, uniform"), Named("z2", "0 to 1, uniform"))
    assert violated.verdict == "VIOLATED"
    assert violated.answer.startswith("VIOLATED for the simulator any-function. ")
    assert [each.requirement for each in violated.claims] == ["", "REQ-1 (low)", "REQ-2 (high)"]
    assert "The first claim was chosen beforehand." in violated.claims[-1].notes[-1]
    assert any("rollouts violate the specification" in each for each in violated.checks)


def test_what_was_not_checked_follows_from_the_campaign(cases: dict[str, SafetyCase], violated: SafetyCase) -> None:
    for case in (*cases.values(), violated):
        assert "Whether the real system behaves like the simulator: no test was made on it." in case.unchecked
        assert case.unchecked[-1] == "Who made the certificate: no signature was checked."
    assert "Whether rollouts repeat: none was simulated again." in violated.unchecked
    assert not any("repeat" in each for each in cases["rigorous"].unchecked)
    assert any("Any single start" in each for each in cases["sample"].unchecked)
    assert not any("Any single start" in each for each in cases["rigorous"].unchecked)


def test_a_signature_counts_only_where_it_was_checked(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    shutil.copytree(FIXTURES / "sample", directory)
    for name in ("alice", "bob"):
        keys.new_pair(tmp_path, name)
    assert made(directory).signatures == ("The certificate is not signed.",)
    sign.sign_certificate(directory, keys.load_private(tmp_path / "alice.key"))
    (claimed,) = made(directory).signatures
    assert re.fullmatch("The certificate has a signature by key [0-9a-f]{64}: not checked here.", claimed)
    checked = made(directory, tmp_path / "alice.pub")
    assert checked.signed
    assert re.fullmatch("Signed by the Ed25519 key [0-9a-f]{64}: checked.", checked.signatures[0])
    assert checked.unchecked[-1] == "Whose keys the signatures are."
    with pytest.raises(EvidenceError, match=r"no signature by .*bob.pub: no signature by key"):
        made(directory, tmp_path / "alice.pub", tmp_path / "bob.pub")


def test_a_campaign_that_does_not_verify_has_no_safety_case() -> None:
    certificate = files.read(FIXTURES / "sample")
    assert certificate is not None
    with pytest.raises(EvidenceError, match="is not verified: files: 1 of 9"):
        safety_case(FIXTURES / "sample", [], certificate, [Check("files", "failed", "1 of 9")])


# The argument

KINDS = {"G": {"G", "S", "Sn"}, "S": {"G"}}


def check_form(elements: tuple[Element, ...]) -> None:
    """Check the rules of the notation: one root, known ids, no cycle, kinds that fit, no goal without support."""
    known = {each.id: each for each in elements}
    assert len(known) == len(elements)
    pointed = [name for each in elements for name in (*each.supported_by, *each.in_context_of)]
    assert set(pointed) == known.keys() - {"G1"}
    assert len(pointed) == len(set(pointed)), "a tree"
    for each in elements:
        assert {known[name].kind for name in each.supported_by} <= KINDS.get(each.kind, set())
        assert {known[name].kind for name in each.in_context_of} <= {"C", "A", "J"}
        if each.kind in ("G", "S"):
            assert bool(each.supported_by) != each.undeveloped
        assert each.text


@pytest.mark.parametrize("method", METHODS)
def test_the_argument_is_well_formed_and_names_every_assumption(cases: dict[str, SafetyCase], method: str) -> None:
    case = cases[method]
    elements = argument(case)
    check_form(elements)
    text = " ".join(each.text for each in elements)
    for each in case.assumptions:
        assert each.id in text
    assumed = [each for each in elements if each.kind == "A"]
    assert len(assumed) == len(case.with_status("assumed"))
    assert all("To be judged by " in each.text for each in assumed)


def test_the_file_of_the_argument_is_yaml_that_a_reader_of_the_form_takes(violated: SafetyCase) -> None:
    import yaml

    elements = argument(violated)
    check_form(elements)
    found: dict[str, Any] = yaml.safe_load(to_yaml(elements))
    assert list(found) == [each.id for each in elements]
    assert found["G1"]["supportedBy"] == ["S1"]
    assert "REQ-1 (low): value ≥ 0" in found["C3"]["text"]
    assert {key for each in found.values() for key in each} <= {"text", "supportedBy", "inContextOf", "undeveloped"}
    assert [name for name, each in found.items() if each.get("undeveloped")] == ["G8"]


def test_what_is_refuted_is_marked(violated: SafetyCase) -> None:
    marked = [each.id for each in argument(violated) if each.refuted]
    assert marked == ["G1", "G2"], "the verdict, and what the rollouts show"
    broken = violated.assumptions[0]._replace(status="refuted")
    elements = argument(replace(violated, assumptions=(broken, *violated.assumptions[1:])))
    (tested,) = [each for each in elements if each.text.startswith("REFUTED by the data")]
    assert tested.refuted
    assert broken.id in tested.text


def test_every_assumption_has_a_judge() -> None:
    judged = [name for names in BY_JUDGE.values() for name in names]
    assert sorted(judged) == sorted(STATEMENTS)
    assert judge_of("simulator_is_the_system") != judge_of("simulator_is_the_system", "measured_system")
    assert judge_of("of_another_version") == "an expert for the system"
    assert set(OF_FORMS.values()) <= BY_JUDGE.keys()


# The files


def pages(data: bytes) -> int:
    return len(re.findall(rb"/Type /Page\b", data))


def words_in(case: SafetyCase) -> str:
    """Return the texts of the pages before the drawing."""
    return " ".join(each.get_text() for page in text_pages(case) for each in page.texts)


@pytest.mark.parametrize("method", ["paper", "sample"])
def test_the_document_has_four_pages_at_most_and_says_what_the_case_says(
    cases: dict[str, SafetyCase], method: str
) -> None:
    data = to_pdf(cases[method])
    assert 2 <= pages(data) <= MOST_PAGES
    text = words_in(cases[method])
    for heading in ("1  What is claimed", "5  What was not checked, and is not claimed", "6  Evidence and signature"):
        assert heading in text
    assert cases[method].certificate_sha256 in text


def test_equal_cases_give_equal_files_and_the_drawing_is_svg(cases: dict[str, SafetyCase]) -> None:
    first, second = case_files(cases["sample"]), case_files(cases["sample"])
    assert first == second
    assert list(first) == [PDF, SVG, YAML]
    assert ElementTree.fromstring(first[SVG]).tag.endswith("svg")


@pytest.mark.parametrize(
    "longer",
    [
        lambda case: replace(case, assumptions=case.assumptions * 8),
        lambda case: replace(case, requirements=tuple(Named(f"R-{k}", "always (x > 1) " * 600) for k in range(50))),
        lambda case: replace(case, domain=tuple(Named(f"knot_{k}", "0 to 1 m/s2") for k in range(2000))),
        lambda case: replace(case, claims=case.claims * 100, unchecked=case.unchecked * 30),
        lambda case: replace(case, answer="x" * 5000, question="мир 世界 $a_b$ \\alpha " * 200),
    ],
)
def test_however_long_a_case_is_the_document_has_four_pages(
    cases: dict[str, SafetyCase], longer: Callable[[SafetyCase], SafetyCase]
) -> None:
    case = longer(cases["rigorous"])
    assert len(text_pages(case)) < MOST_PAGES
    text = words_in(case)
    for heading in ("5  What was not checked, and is not claimed", "6  Evidence and signature", "7  Words"):
        assert heading in text
    assert case.signatures[0] in text


def test_a_text_is_wrapped_to_its_width_and_loses_no_letter() -> None:
    text = "a certificate of " + "0123456789abcdef" * 8
    lines = wrapped(text, 9.0, 2.0)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert len(lines) > 3
    assert wrapped("", 9.0, 2.0) == [""]


def test_no_two_boxes_of_the_drawing_overlap(cases: dict[str, SafetyCase]) -> None:
    for case in cases.values():
        elements = argument(case)
        figure = drawing(elements, "title")
        # The texts are in their shapes: each is drawn, and none is beyond the drawing.
        axes = figure.axes[0]
        assert len(axes.texts) >= len(elements)
        width, height = figure.get_size_inches()
        for each in axes.texts:
            x, y = each.get_position()
            assert 0 <= x <= width
            assert 0 <= y <= height
        for one, other in itertools.combinations(placed(elements), 2):
            beside = abs(one.x - other.x) >= (one.width + other.width) / 2
            assert beside or one.bottom <= other.y or other.bottom <= one.y, (one.element.id, other.element.id)
