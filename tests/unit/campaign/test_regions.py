"""A campaign that divides its box: certificate, table, sentences, and what `verify` accepts and refuses."""

import csv
import hashlib
import io
import json
import math
import shutil
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import ValidationError
from rich.console import Console

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.plan import plan, unsafe_below
from perfbound.orchestrator.certificate import files, regions
from perfbound.orchestrator.certificate.verify import regions as check
from perfbound.orchestrator.certificate.words.region_text import NONE, region_sentences, unsafe_words
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.mathematics.bounds.rigorous.regions import MARGIN, Regions
from perfbound.orchestrator.run import service
from perfbound.schemas.result.certificate import Certificate, CertifiedRegions
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts, says
from tests.fakes.simulators import noise, predicate, robustness, simulate, spec, statuses, verified

EXACT: dict[str, Any] = {
    "method": "rigorous",
    "alpha": 1e-3,
    "rkhs_norm": 2.0,
    "noise_scale": 0.0,
    "kernel": {"nu": 2.5, "length_scale": 0.5},
}
CHECKS = {"spot_check": 40, "recheck": 2, "max_tests": 30}


@pytest.fixture(autouse=True, scope="module")
def impatient() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        patch.setattr(service, "TICK", 0.01)
        yield


def wave(request: RolloutRequest) -> float:
    """Return a value that is negative on a quarter of the square, about."""
    z1, z2 = request.x
    return 0.1 + 0.5 * math.sin(4 * z1) * math.cos(3 * z2)


def gone(request: RolloutRequest) -> float:
    """Return `wave` with a narrow hole that no test of a search sees."""
    return -1.0 if max(abs(request.x[0] - 0.3), abs(request.x[1] - 0.05)) < 0.045 else wave(request)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("original") / "run"
    assert simulate(directory, robustness(EXACT, regions=True, **CHECKS), wave, noisy=False) is not None
    return directory


@pytest.fixture
def campaign(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "run"))


def certificate(directory: Path) -> Certificate:
    return Certificate.model_validate_json((directory / files.CERTIFICATE).read_text())


def printed(directory: Path) -> str:
    console = Console(width=200, record=True, file=io.StringIO())
    print_certificate(certificate(directory), console)
    return console.export_text()


def rewritten(directory: Path, rows: list[str], **changed: float) -> None:
    """Write another table, and a certificate that fits it."""
    text = "\r\n".join(rows) + "\r\n"
    (directory / files.REGIONS).write_bytes(text.encode())
    value = json.loads((directory / files.CERTIFICATE).read_text())
    value["predicate"]["regions"] |= {"sha256": hashlib.sha256(text.encode()).hexdigest(), "boxes": len(rows) - 1}
    value["predicate"]["regions"] |= changed
    for claim in value["predicate"]["claims"]:
        if claim["quantity"] == "safe_share" and "safe" in changed:
            claim["bound"] = changed["safe"]
    (directory / files.CERTIFICATE).write_text(Certificate.model_validate_json(json.dumps(value)).to_json())


class TestCertificate:
    @pytest.mark.rest
    def test_the_shares_are_those_of_the_table(self, original: Path) -> None:
        found = certificate(original).predicate.regions
        assert found is not None
        assert found.safe + found.unsafe + found.undecided == 1.0
        assert min(found.safe, found.unsafe) > 0.1
        assert (found.probability, found.unsafe_below) == (1.0, 0.0)
        data = (original / files.REGIONS).read_bytes()
        assert found.sha256 == hashlib.sha256(data).hexdigest()
        header, *rows = csv.reader(data.decode().splitlines())
        assert header == ["z1 low", "z1 high", "z2 low", "z2 high", "status"]
        assert len(rows) == found.boxes
        area = {"safe": 0.0, "unsafe": 0.0, "undecided": 0.0}
        for a, b, c, d, status in rows:
            area[status] += (float(b) - float(a)) * (float(d) - float(c))
            if status != "undecided":
                centre = (float(a) + float(b)) / 2, (float(c) + float(d)) / 2
                value = 0.1 + 0.5 * math.sin(4 * centre[0]) * math.cos(3 * centre[1])
                assert (value > 0) == (status == "safe")
        assert area == pytest.approx({name: getattr(found, name) for name in area})

    def test_the_claim_of_the_share_is_the_second_one(self, original: Path) -> None:
        found = certificate(original).predicate
        first, second = found.claims
        assert found.regions is not None
        assert (first.quantity, second.quantity, second.sense) == ("robustness", "safe_share", ">=")
        assert (second.bound, second.probability) == (found.regions.safe, 1.0)
        assert second.assumptions == first.assumptions
        assert (second.without_data, second.vacuous, second.by_clip) == (0.0, False, None)
        assert found.question["regions"] is True

    def test_the_sentences(self, original: Path) -> None:
        text = printed(original)
        assert "Regions\n  Certified safe: at least " in text
        assert says(text, "Safe: above 0")
        assert "the first claim with them, with certainty, given the assumptions." in text
        assert " fresh starts in certified boxes have another sign." in text
        assert says(text, "also certified safe >= 0.")

    def test_a_campaign_without_the_key_has_none_of_it(self, tmp_path: Path) -> None:
        text = simulate(tmp_path / "run", robustness(EXACT, **CHECKS), wave, noisy=False)
        assert "regions" not in predicate(text)
        assert "regions" not in predicate(text)["question"]
        assert not (tmp_path / "run" / files.REGIONS).exists()
        assert verified(tmp_path / "run") == []
        assert "regions" not in robustness(EXACT).model_dump(mode="json")

    def test_a_refuted_campaign_has_no_regions(self, tmp_path: Path) -> None:
        config = robustness(EXACT | {"rkhs_norm": 0.3}, regions=True, **CHECKS)
        text = simulate(tmp_path / "run", config, wave, noisy=False)
        assert "regions" not in predicate(text)
        assert [each["quantity"] for each in predicate(text)["claims"]] == ["robustness"]
        assert NONE in printed(tmp_path / "run")
        assert verified(tmp_path / "run") == []

    @pytest.mark.rest
    def test_a_fresh_start_with_another_sign_refutes_the_norm(self, tmp_path: Path) -> None:
        config = robustness(EXACT, regions=True, **CHECKS | {"spot_check": 600})
        text = simulate(tmp_path / "run", config, gone, noisy=False)
        assert predicate(text)["regions"]["contradicted"] > 0
        assert statuses(text)["rkhs_norm/robustness"] == "refuted"
        assert predicate(text)["claims"][1]["refuted"] == ["rkhs_norm/robustness"]
        assert "REFUTED: " in printed(tmp_path / "run").split("Regions")[1]
        assert verified(tmp_path / "run") == []

    @pytest.mark.rest
    def test_noise_and_a_stop_by_hand(self, tmp_path: Path) -> None:
        problem = EXACT | {"noise_scale": 0.02, "kernel": {"nu": 2.5, "length_scale": 1.0}, "rkhs_norm": 3.0}
        config = robustness(problem, regions=True, clip=[-1, 1], **CHECKS)

        def shaky(request: RolloutRequest) -> float:
            return wave(request) + 0.02 * noise(request.seed) / 4

        stopped = simulate(
            tmp_path / "run",
            config,
            shaky,
            stop=lambda request: request.rollout.startswith("robustness.12."),
            noisy=True,
        )
        assert stopped is None
        resumed = simulate(tmp_path / "run", config, shaky, noisy=True)
        assert resumed == simulate(tmp_path / "calm", config, shaky, workers=1, noisy=True)
        tables = [(tmp_path / name / files.REGIONS).read_bytes() for name in ("run", "calm")]
        assert tables[0] == tables[1]
        found = predicate(resumed)["regions"]
        assert (found["probability"], found["contradicted"]) == (0.95, None)
        assert found["safe"] > 0.1
        assert "expected robustness" in printed(tmp_path / "run").split("Regions")[1]
        assert verified(tmp_path / "run") == []


class TestRisk:
    @pytest.mark.parametrize(
        ("clip", "centre", "limit"), [([-0.05, 0.75], 0.7, -0.420333334), ([-1.0, 1.0], -0.9, None)]
    )
    def test_unsafe_is_below_every_law_without_negative_risk(
        self, clip: list[float], centre: float, limit: float | None
    ) -> None:
        """The second clip: the constants are so far from its upper end that X is lowest there, at a risk of 1."""
        constants = {"centre": centre, "spread": 0.12}
        problem = EXACT | {"name": "true_risk", "linearised": constants}
        config = robustness(problem, regions=True, clip=clip, horizon=1.0)
        system = spec(noisy=True).model_copy(update={"variants": ("true",), "noisy": ("true",)})
        assert unsafe_below(plan(config, system, config.problems[0])) == limit

    @pytest.mark.parametrize(
        ("quantity", "named"), [("expected_robustness", True), ("rho_star", True), ("robustness", False)]
    )
    def test_the_sentences_name_a_clip_that_may_change_a_sign(self, quantity: Any, *, named: bool) -> None:
        """A clipped value has the sign of the value; a mean of clipped values may have another."""
        shares: dict[str, Any] = {"safe": 1.0, "unsafe": 0.0, "undecided": 0.0, "probability": 0.95, "boxes": 1}
        found = CertifiedRegions(**shares, sha256="", checked=None, contradicted=None, unsafe_below=0.0)
        claim = SimpleNamespace(quantity=quantity, refuted=())
        predicate: Any = SimpleNamespace(regions=found, claims=[claim], question={"clip": [-0.2, 1]})
        _, safe, unsafe, *_ = region_sentences(predicate)
        assert [", clipped to [-0.2, 1], is" in each for each in (safe, unsafe)] == [named] * 2
        predicate.question = {}
        assert "clipped" not in "".join(region_sentences(predicate)), "without a clip"

    def test_the_sentences_name_the_threshold(self) -> None:
        shares: dict[str, Any] = {"safe": 0.5, "unsafe": 0.0, "undecided": 0.5, "probability": 0.95, "boxes": 2}
        shares |= {"sha256": "", "checked": None, "contradicted": None}
        found = [CertifiedRegions(**shares, unsafe_below=limit) for limit in (-0.420333334, None, 0.0)]
        words = [unsafe_words("robustness risk", each) for each in found]
        assert says(words[0], "^Unsafe: below -0.4204")
        assert words[1].startswith("No start can be certified unsafe")
        assert words[2].startswith("Unsafe: the robustness risk is below 0")


class TestFile:
    @pytest.mark.parametrize(
        ("problem", "changes", "message"),
        [
            (
                {"method": "scenario", "alpha": 0.1},
                {"clip": [-1, 1], "space": {"scenarios": [[0, 0]]}},
                "'rigorous'",
            ),
            (EXACT, {"space": {"scenarios": [[0.0, 0.0], [1.0, 1.0]]}}, "a list of starts has no regions"),
            (EXACT, {"where": "z1 + z2 <= 1"}, "space.where: candidates"),
            (EXACT, {"where": "z1 + z2 <= 1", "candidates": 64}, "`where` `candidates`"),
            (EXACT, {"candidates": 100}, "`candidates`"),
            (EXACT, {"clip": [0.0, 1.0]}, "clip: [0.0, 1.0] 0"),
            (EXACT | {"name": "maximum", "column": "value"}, {}, "'true_risk' 'robustness'"),
        ],
    )
    def test_what_has_no_regions_is_refused(self, problem: dict[str, Any], changes: Any, message: str) -> None:
        with pytest.raises(ValidationError, match=facts(message)):
            robustness(problem, regions=True, **changes)

    def test_the_key_is_part_of_the_identity_and_left_out_at_its_default(self) -> None:
        assert robustness(EXACT).digest == robustness(EXACT, regions=False).digest
        assert robustness(EXACT).digest != robustness(EXACT, regions=True).digest


class TestVerify:
    @pytest.mark.rest
    def test_an_honest_campaign_passes(self, original: Path) -> None:
        assert verified(original) == []

    @pytest.mark.rest
    def test_an_edited_table(self, campaign: Path) -> None:
        path = campaign / files.REGIONS
        path.write_bytes(path.read_bytes().replace(b"undecided", b"safe", 1))
        assert verified(campaign) == ["regions"]

    @pytest.mark.rest
    def test_a_missing_table(self, campaign: Path) -> None:
        (campaign / files.REGIONS).unlink()
        assert verified(campaign) == ["regions"]

    @pytest.mark.rest
    def test_a_share_of_a_table_that_fits_it_and_not_the_evidence(self, campaign: Path) -> None:
        header, *rows = (campaign / files.REGIONS).read_text().splitlines()
        found = certificate(campaign).predicate.regions
        assert found is not None
        number = next(k for k, row in enumerate(rows) if row.endswith("undecided"))
        a, b, c, d = map(float, rows[number].split(",")[:4])
        rows[number] = rows[number].replace("undecided", "safe")
        grown = found.safe + (b - a) * (d - c)
        rewritten(campaign, [header, *rows], safe=grown, undecided=1.0 - grown - found.unsafe)
        assert verified(campaign) == ["regions"]

    @pytest.mark.rest
    def test_a_claim_with_another_share(self, campaign: Path) -> None:
        text = (campaign / files.CERTIFICATE).read_text()
        value = json.loads(text)
        value["predicate"]["claims"][1]["bound"] += 0.01
        (campaign / files.CERTIFICATE).write_text(Certificate.model_validate_json(json.dumps(value)).to_json())
        assert verified(campaign) == ["regions"]

    @pytest.mark.rest
    def test_without_regions_in_the_certificate(self, campaign: Path) -> None:
        value = json.loads((campaign / files.CERTIFICATE).read_text())
        del value["predicate"]["regions"]
        del value["predicate"]["claims"][1]
        (campaign / files.CERTIFICATE).write_text(Certificate.model_validate_json(json.dumps(value)).to_json())
        assert "regions" in verified(campaign)

    def test_boxes_that_are_exactly_those_of_the_evidence_pass_beside_another_table(
        self, campaign: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The table that is computed anew differs, and with no margin at all the boxes are those of the evidence."""
        honest = regions.divided
        monkeypatch.setattr(regions, "divided", lambda ledger, margin=MARGIN: honest(ledger, margin + 5e-4))
        monkeypatch.setattr(check, "SHIFT", 0.0)
        assert verified(campaign) == []

    @pytest.mark.rest
    def test_round_off_of_another_cpu_passes(self, campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """This CPU proves with a little less margin what the recorded one did not, or the other way round."""
        honest = regions.divided

        def moved(shift: float, ledger: Ledger, margin: float = MARGIN) -> Regions | None:
            return honest(ledger, margin + shift)

        for shift in (5e-4, -5e-4):
            for module in (regions, check):
                monkeypatch.setattr(module, "divided", partial(moved, shift))
            monkeypatch.setattr(check, "SHIFT", 1e-3)
            assert verified(campaign) == []
            monkeypatch.setattr(check, "SHIFT", 1e-4)
            assert verified(campaign) == ["regions"]
