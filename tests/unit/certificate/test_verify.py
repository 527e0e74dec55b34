"""A certificate is verified from its evidence, and every way of tampering that we could think of is caught by the line
that is about it."""

import hashlib
import io
import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.issue import issue, manifest
from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.orchestrator.certificate.verify import compare
from perfbound.orchestrator.certificate.verify import table as show
from perfbound.orchestrator.certificate.verify.checks import ABSENT, CHECKS, Checks
from perfbound.orchestrator.certificate.verify.manifest import parse_manifest
from perfbound.orchestrator.certificate.verify.rerun import Rerun
from perfbound.orchestrator.certificate.verify.run import Verification, verify_certificate
from perfbound.orchestrator.certificate.verify.stages import stage_bars
from perfbound.orchestrator.certificate.words import text
from perfbound.orchestrator.fleet.children import simulate
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.attempt_record import table_digests
from perfbound.orchestrator.store.files import relative_path
from perfbound.orchestrator.store.read import observed, read_header, reading
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.orchestrator.store.untrusted import UntrustedFacts, read_untrusted
from perfbound.schemas.base import canonical_json
from perfbound.schemas.errors import PerfboundError, Stopped
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import FileId, RolloutId
from perfbound.schemas.result.block_facts import BatchFact, StoredFact
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.result.facts import DiscardFact, ExtensionFact, RolloutFact
from perfbound.schemas.system import SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap
from tests.campaigns import table
from tests.facts import says
from tests.fakes.puppets import Stage
from tests.tampering import editing

TESTS = 8
FINISHED = Path(__file__).parents[2] / "fixtures" / "finished"


def shortened(name: str, tests: int = TESTS, **changes: Any) -> CampaignConfig:
    """Return a shipped campaign that ends soon by its budget."""
    found = table(name, visual="none", **changes)
    for problem in found["problems"]:
        problem |= {"max_tests": tests, "alpha": 1e-9}
    return CampaignConfig.model_validate_json(json.dumps(found))


def run(directory: Path, config: CampaignConfig) -> Path:
    """Run a campaign with puppets for workers, to its certificate."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        patch.setattr(service, "TICK", 0.01)
        stage = Stage(directory, config, 4)
        stage.play()
        found = manifest((sha256, path) for _, sha256, path in observed(directory))
        certificate = issue(stage.ledger, found)
        files.write(directory, certificate, found.text, attempts=table_digests(directory))
        stage.journal.close()
    return directory


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("original") / "run", shortened("segway-paper"))


@pytest.fixture
def campaign(original: Path, tmp_path: Path) -> Path:
    """A copy of a finished campaign: two problems, eight tests each."""
    return Path(shutil.copytree(original, tmp_path / "run"))


def check(directory: Path, key: Path | None = None) -> Checks:
    found = verify_certificate(directory, key=key, again=0, report=lambda *_: None).checks
    assert [line.name for line in found.lines()] == list(CHECKS)
    return found


def failed(directory: Path, key: Path | None = None) -> list[str]:
    return [line.name for line in check(directory, key).lines() if line.status == "failed"]


def skipped(found: Checks) -> set[str]:
    return {line.name for line in found.lines() if line.status == "skipped"}


def absent(directory: Path) -> set[str]:
    """Return the checks of parts that a certificate does not have."""
    found = files.read(directory)
    assert found is not None
    return {name for name in ABSENT if getattr(found.predicate, name.replace(" ", "_")) is None}


# Untouched


@pytest.mark.parametrize("name", ["segway-paper", "segway-pair", "segway-scenario", "test-function"])
def test_an_honest_campaign_passes_everything(name: str, tmp_path: Path) -> None:
    changes: dict[str, Any] = {"window": 3} if name == "segway-scenario" else {}
    config = shortened(name, 26 if name == "segway-scenario" else TESTS, **changes)
    found = check(run(tmp_path / "run", config))
    assert {line.name: line.detail for line in found.lines() if line.status == "failed"} == {}
    assert skipped(found) == {"signature", "resimulation"} | absent(tmp_path / "run")


def test_a_check_of_nothing_did_not_pass(tmp_path: Path) -> None:
    one = Path(shutil.copytree(FINISHED / "sample", tmp_path / "run"))
    assert skipped(check(one)) >= absent(one) == set(ABSENT)


def printed(directory: Path) -> list[str]:
    found = verify_certificate(directory, key=None, again=0, report=lambda *_: None)
    console = Console(file=io.StringIO(), width=100)
    show.print_verification(found, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


@pytest.mark.rest
def test_the_result_is_last_and_does_not_hide_a_refuted_claim(campaign: Path, tmp_path: Path) -> None:
    lines = printed(campaign)
    begin = next(number for number, line in enumerate(lines) if line.startswith("CLAIM"))
    bound = next(line for line in lines[begin:] if ">= " in line)
    assert bound.endswith(" rad"), "the unit of the robustness"
    refuted, good = (
        printed(Path(shutil.copytree(FINISHED / name, tmp_path / name)))[-1] for name in ("paper", "scenario")
    )
    assert says(refuted, "^VERIFIED signature not checked")
    assert says(refuted, "skipped claim REFUTED not rely")
    assert good.endswith("skipped")


def test_the_result_says_that_the_record_of_attempts_was_not_checked(tmp_path: Path) -> None:
    directory = Path(shutil.copytree(FINISHED / "scenario", tmp_path / "run"))
    (directory / files.ATTEMPTS).unlink()
    assert says(printed(directory)[-1], "^VERIFIED signature record attempts not checked")


def test_an_edited_certificate_without_a_value_of_its_clip_is_shown(tmp_path: Path) -> None:
    directory = Path(shutil.copytree(FINISHED / "kriging", tmp_path / "run"))
    value = json.loads((directory / files.CERTIFICATE).read_text())
    (clip,) = [each for each in value["predicate"]["assumptions"] if each["id"].startswith("clip/")]
    clip["values"] = {"at_low": 1}
    value["predicate"]["claims"][0]["clipped"] = [-0.05, 0.75]
    (directory / files.CERTIFICATE).write_text(json.dumps(value))
    found = files.read(directory)
    assert found is not None
    assert any(says(note, "1 of ? values lower clip ?") for note in text.notes(found.predicate, 0))


def test_verifying_changes_nothing(campaign: Path) -> None:
    def look() -> dict[str, tuple[int, int]]:
        return {str(p): (p.stat().st_mtime_ns, p.stat().st_size) for p in campaign.rglob("*")}

    before = look()
    assert check(campaign).good
    assert look() == before


@pytest.mark.parametrize(
    ("gone", "more"),
    [
        (["bounds", "observations"], set()),
        (["bounds", "observations", "rollouts"], set()),
        (["bounds", "observations", "rollouts", "tests"], {"database", "attempts"}),
    ],
)
@pytest.mark.parametrize("drop", [True, False])
def test_the_evidence_alone_is_enough(campaign: Path, gone: list[str], more: set[str], *, drop: bool) -> None:
    with editing(campaign) as database:
        for name in gone:
            database.execute(f"DROP TABLE {name}" if drop else f"DELETE FROM {name}")
    found = check(campaign)
    assert found.good
    assert skipped(found) == {"signature", "resimulation"} | absent(campaign) | more


# The database


@pytest.mark.parametrize(
    ("statement", "line", "says"),
    [
        ("UPDATE rollouts SET robustness = robustness + 1e-6 WHERE seq % 7 = 0", "database", "robustness"),
        ("UPDATE rollouts SET seed = seed + 1 WHERE test = 3", "database", "seed"),
        ("UPDATE rollouts SET sha256 = replace(sha256, 'a', 'b') WHERE test = 3", "database", "sha256"),
        ("DELETE FROM tests WHERE problem = 'sim_gap' AND test = 4", "database", "sim_gap, test 4 is missing"),
        ("DELETE FROM rollouts WHERE problem = 'sim_gap' AND test = 4", "database", "is missing"),
        ("UPDATE observations SET y = y + 1e-6 WHERE test = 2", "database", "y is"),
        ("UPDATE bounds SET upper = upper - 0.01 WHERE test = 7", "database", "upper"),
        ("UPDATE bounds SET stopped_by = 'converged' WHERE test = 7", "database", "stopped_by"),
        ("UPDATE bounds SET stopped_by = 'budget' WHERE test = 5", "database", "stopped_by"),
        ("UPDATE tests SET mu = mu + 1e-6 WHERE test = 6", "database", "mu"),
        ("UPDATE tests SET x = '[1.0,1.0]' WHERE test = 6", "database", "x[0]"),
        ("UPDATE tests SET x = 'no' WHERE test = 6", "database", "cannot be read"),
        ("UPDATE campaign SET config = replace(config, '0.05', '0.06')", "header", "campaign file"),
    ],
)
def test_an_edited_database(campaign: Path, statement: str, line: str, says: str) -> None:
    with editing(campaign) as database:
        assert database.execute(statement).rowcount > 0
    found = check(campaign).found[line]
    assert found.status == "failed"
    assert says in found.detail


def test_a_test_that_never_was(campaign: Path) -> None:
    with editing(campaign) as database:
        database.execute(
            "INSERT INTO tests SELECT 9999, problem, 99, node, x, mu, sigma, beta, F, 1, NULL, NULL FROM tests "
            "WHERE test = 3 LIMIT 1"
        )
    assert failed(campaign) == ["database"]


def test_an_edited_fact_with_a_chain_that_was_built_again(campaign: Path) -> None:
    """Every digest in the database and the head in the certificate fit the edited y; the trajectory does not."""
    with editing(campaign) as database:
        database.execute("UPDATE observations SET y = y + 0.01 WHERE problem = 'sim_gap' AND test = 2")
    there = read_untrusted(campaign)
    facts: list[StoredFact] = [*there.proposals, *there.rollouts, *there.observations]
    head = compare.chain_head(there.header, facts, there.proposals)
    rewrite(campaign, lambda predicate: predicate["evidence"].update(chain_head=head))
    assert set(failed(campaign)) == {"chain", "database"}


# The certificate


def rewrite(directory: Path, edit: Callable[[Any], object]) -> None:
    """Edit the certificate, and write it as perfbound would."""
    path = directory / files.CERTIFICATE
    value = json.loads(path.read_text())
    edit(value["predicate"])
    written(directory, Certificate.model_validate_json(json.dumps(value)))


def written(directory: Path, certificate: Certificate) -> None:
    files.write(directory, certificate, (directory / files.MANIFEST).read_text(), attempts=table_digests(directory))


@pytest.mark.parametrize(
    ("edit", "line"),
    [
        (lambda p: p["problems"][0].update(bound=p["problems"][0]["bound"] + 0.01), "problems"),
        (lambda p: p["problems"][1].update(tests=9), "problems"),
        (lambda p: p["problems"][1]["parameters"].update(rkhs_norm=3.0), "problems"),
        (lambda p: p["problems"][1].update(stopped_by="converged"), "problems"),
        (lambda p: p["problems"][0].update(probability=0.99), "probabilities"),
        (lambda p: p["claims"][0].update(probability=0.99), "probabilities"),
        (lambda p: p["claims"][0].update(bound=0.5), "claims"),
        (lambda p: p["claims"][0].update(refuted=["rkhs_norm/sim_gap"]), "claims"),
        (lambda p: p["composition"].update(risk_term=0.01), "composition"),
        (lambda p: p["assumptions"][0].update(status="derived"), "audit"),
        (lambda p: p["assumptions"].pop(), "audit"),
        (lambda p: p["assumptions"][0]["values"].update(rkhs_norm=0.31), "audit"),
        (lambda p: p["assumptions"][0].update(values={}), "audit"),
        (lambda p: p["assumptions"][-1].update(detail="all is well"), "audit"),
        (lambda p: p.update(rules=2), "header"),
        (lambda p: p["question"].update(specification="always (abs(phi) <= 2)"), "header"),
        (lambda p: p["campaign"].update(seed=2), "header"),
        (lambda p: p["software"].update(numpy="9.9"), "header"),
        (lambda p: p["evidence"].update(chain_head="0" * 64), "chain"),
        (lambda p: p["evidence"].update(rollouts=7), "evidence"),
    ],
)
def test_an_edited_certificate(campaign: Path, edit: Callable[[Any], object], line: str | None) -> None:
    rewrite(campaign, edit)
    assert (line in failed(campaign)) if line else failed(campaign) == []


@pytest.mark.parametrize(
    "edit",
    [
        {"detail": "all is well"},
        {"detail": ""},
        {"form": "independence"},
        {"form": "no such form"},
        {"form": "independence", "detail": "all is well"},
    ],
)
def test_a_sentence_is_that_of_its_form_and_its_values(campaign: Path, edit: dict[str, str]) -> None:
    rewrite(campaign, lambda predicate: predicate["assumptions"][-1].update(edit))
    found = verify_certificate(campaign, key=None, again=0, report=lambda *_: None)
    assert found.checks.found["audit"].status == "failed"


def test_the_sentences_of_another_version_are_counted(campaign: Path) -> None:
    def edit(predicate: Any) -> None:
        predicate["assumptions"][-1].update(detail="all is well")
        predicate["software"]["perfbound"] = "0.1.0"

    rewrite(campaign, edit)
    with editing(campaign) as database:
        database.execute(
            'UPDATE campaign SET software = replace(software, \'"perfbound":"0.2.0"\', \'"perfbound":"0.1.0"\')'
        )
    found = verify_certificate(campaign, key=None, again=0, report=lambda *_: None)
    assert says(found.checks.found["audit"].detail, "certificate 1 below")
    assert found.reissued is not None
    assert "all is well" not in found.reissued.to_json()


@pytest.mark.parametrize(
    "edit", [lambda text: text + " ", lambda text: text.replace("{", '{"a": 1, ', 1), lambda _: "{}", lambda _: "\xff"]
)
def test_a_certificate_that_is_none(campaign: Path, edit: Callable[[str], str]) -> None:
    path = campaign / files.CERTIFICATE
    path.write_text(edit(path.read_text()))
    assert failed(campaign) == ["certificate"]


@pytest.mark.rest
def test_a_signature(campaign: Path, tmp_path: Path) -> None:
    ours, theirs = (keys.new_pair(tmp_path, name) for name in ("ours", "theirs"))
    paths = [ours.public, theirs.public]
    assert failed(campaign, paths[0]) == ["signature"], "it is not signed"
    sign.sign_certificate(campaign, keys.load_private(ours.private))
    assert check(campaign, paths[0]).found["signature"].status == "passed"
    assert failed(campaign, paths[1]) == ["signature"]
    assert check(campaign).good, "a signature without --key is no fault"
    rewrite(campaign, lambda predicate: predicate["claims"][0].update(bound=0.5))
    assert failed(campaign, paths[0]) == ["signature"], "what was signed is another text"
    (campaign / files.CERTIFICATE).unlink()
    (campaign / files.ATTEMPTS).unlink()
    assert check(campaign / files.ENVELOPE, paths[0]).good, "the envelope is the certificate"
    with pytest.raises(PerfboundError, match="--key"):
        check(campaign / files.ENVELOPE)


# The files


def some_files(directory: Path) -> list[Path]:
    return sorted((directory / "trajectories").rglob("*.mcap"))


@pytest.mark.rest
def test_a_flipped_bit_in_each_of_a_hundred_places(campaign: Path) -> None:
    rng = random.Random(4)
    for _ in range(100):
        path = rng.choice(some_files(campaign))
        good = path.read_bytes()
        bit = rng.randrange(8 * len(good))
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(bad)
        found = check(campaign)
        assert [line.name for line in found.lines() if line.status == "failed"] == ["files"]
        assert path.name in found.found["files"].detail
        path.write_bytes(good)
    assert check(campaign).good


def relist(directory: Path, change: Callable[[dict[FileId, str]], object] = lambda _: None) -> None:
    """Make manifest and certificate fit the files again, after a change of the list (rollout -> path)."""
    text = (directory / files.MANIFEST).read_text()
    listed = {rollout: entry.path for rollout, entry in parse_manifest(text).items()}
    change(listed)
    lines = [f"{hashlib.sha256((directory / path).read_bytes()).hexdigest()}  {path}\n" for path in listed.values()]
    (directory / files.MANIFEST).write_text("".join(lines))
    digest = hashlib.sha256("".join(lines).encode()).hexdigest()

    def edit(predicate: Any) -> None:
        predicate["evidence"] |= {"manifest_sha256": digest, "rollouts": len(lines)}

    rewrite(directory, edit)
    value = json.loads((directory / files.CERTIFICATE).read_text())
    value["subject"][0]["digest"]["sha256"] = digest
    written(directory, Certificate.model_validate_json(json.dumps(value)))


@pytest.mark.rest
def test_a_flipped_bit_under_digests_that_were_made_again(campaign: Path) -> None:
    rng = random.Random(5)
    for _ in range(20):
        path = rng.choice(some_files(campaign))
        good = path.read_bytes()
        bad = bytearray(good)
        bad[rng.randrange(len(good))] ^= 4
        path.write_bytes(bad)
        relist(campaign)
        assert failed(campaign) == ["trajectories"], path
        path.write_bytes(good)


def altered(path: Path, **request: Any) -> None:
    """Write a file anew, with good checksums, for another request or with other numbers."""
    file = read_mcap(path.read_bytes())
    numbers = request.pop("numbers", lambda samples: samples)
    samples = numbers(file.trajectory.samples.copy())
    units = dict.fromkeys(file.trajectory.columns, "1")
    metadata = {key: value for key, value in file.metadata.items() if key != "columns"}
    trajectory = Trajectory(file.trajectory.columns, samples)
    path.write_bytes(encode(trajectory, request=file.request | request, metadata=metadata, units=units))


def of(directory: Path, problem: str, test: int, variant: str) -> Path:
    return directory / relative_path(FileId(RolloutId(problem, test, variant, 0)))


def test_a_swapped_seed(campaign: Path) -> None:
    altered(of(campaign, "sim_gap", 3, "true"), seed=77)
    relist(campaign)
    assert failed(campaign) == ["requests"]


def test_swapped_files(campaign: Path) -> None:
    a, b = of(campaign, "sim_gap", 3, "true"), of(campaign, "sim_gap", 4, "true")
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)
    relist(campaign)
    assert failed(campaign) == ["requests"]


def test_another_place_than_the_maximiser(campaign: Path) -> None:
    for variant in ("nominal", "true"):
        altered(of(campaign, "sim_gap", 3, variant), x=[1.0, 1.0])
    relist(campaign)
    found = check(campaign).found["proposals"]
    assert found.status == "failed"
    assert "sim_gap, test 3" in found.detail


def test_other_numbers(campaign: Path) -> None:
    def numbers(samples: Any) -> Any:
        samples[10, 1:] += 0.3
        return samples

    altered(of(campaign, "nominal_robustness", 7, "nominal"), numbers=numbers)
    relist(campaign)
    assert {"database", "problems", "chain"} <= set(failed(campaign))


def test_a_removed_test(campaign: Path) -> None:
    """The last test of a problem, gone from everything that is written down."""
    relist(campaign, lambda listed: listed.pop(FileId(RolloutId("nominal_robustness", 7, "nominal", 0))))
    with editing(campaign) as database:
        for name in ("tests", "rollouts", "observations", "bounds"):
            database.execute(f"DELETE FROM {name} WHERE problem = 'nominal_robustness' AND test = 7")
    assert failed(campaign) == ["stop"]


def test_a_rollout_of_another_campaign(campaign: Path) -> None:
    stranger = FileId(RolloutId("nominal_robustness", 8, "nominal", 0))
    shutil.copy(of(campaign, "nominal_robustness", 7, "nominal"), campaign / relative_path(stranger))
    relist(campaign, lambda listed: listed.update({stranger: relative_path(stranger)}))
    assert failed(campaign) == ["evidence"]
    assert "1 file of no observed test" in check(campaign).found["evidence"].detail


@pytest.mark.parametrize(
    "line",
    [
        "no line of ours\n",
        f"{'0' * 64}  trajectories/../campaign.db\n",
        f"{'0' * 64}  /etc/passwd\n",
        f"{'0' * 64}  trajectories/sim_gap/1/sim_gap.3.true.0.mcap\n",
    ],
)
def test_a_manifest_with_a_line_of_its_own(campaign: Path, line: str) -> None:
    path = campaign / files.MANIFEST
    path.write_text(path.read_text() + line)
    assert failed(campaign) == ["manifest"], "the digest"
    text = path.read_text()
    digest = hashlib.sha256(text.encode()).hexdigest()
    certificate = campaign / files.CERTIFICATE
    old = json.loads(certificate.read_text())["subject"][0]["digest"]["sha256"]
    certificate.write_text(certificate.read_text().replace(old, digest))
    assert failed(campaign) == ["manifest"], "the line"


def test_lines_in_another_order(campaign: Path) -> None:
    def turn(listed: dict[FileId, str]) -> None:
        pairs = list(listed.items())
        listed.clear()
        listed.update(reversed(pairs))

    relist(campaign, turn)
    assert failed(campaign) == ["evidence"]


@pytest.mark.parametrize("name", [files.MANIFEST, DATABASE])
def test_something_is_missing(campaign: Path, name: str) -> None:
    (campaign / name).unlink()
    assert failed(campaign) == ["manifest" if name == files.MANIFEST else "header"]


def test_nothing_to_verify(tmp_path: Path) -> None:
    with pytest.raises(PerfboundError, match="no certificate here"):
        check(tmp_path)


# Deliberate changes


def test_a_pipe_is_not_waited_for(campaign: Path) -> None:
    victim = some_files(campaign)[3]
    victim.unlink()
    os.mkfifo(victim)
    assert failed(campaign) == ["files"]


@pytest.mark.parametrize(
    ("name", "line"), [(files.MANIFEST, "manifest"), (files.CERTIFICATE, "certificate"), ("trajectories", "files")]
)
def test_a_file_as_large_as_a_disk_fills_no_memory(campaign: Path, name: str, line: str) -> None:
    victim = campaign / name if (campaign / name).is_file() else some_files(campaign)[3]
    with victim.open("r+b") as file:
        file.truncate(2**40)
    assert failed(campaign) == [line]


@pytest.mark.parametrize(
    "statement",
    [
        "CREATE VIEW bounds AS SELECT seq, problem, test, y AS upper, y AS lower, NULL AS stopped_by FROM observations",
        "CREATE VIEW bounds AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS seq FROM n",
        "CREATE TABLE bounds (seq INTEGER PRIMARY KEY, problem TEXT, test INTEGER, upper REAL, lower REAL, "
        "stopped_by TEXT GENERATED ALWAYS AS (hex(zeroblob(800000000))))",
        "CREATE TABLE notes (text TEXT)",
    ],
)
def test_tables_that_are_none_of_ours(campaign: Path, statement: str) -> None:
    with editing(campaign) as database:
        database.execute("DROP TABLE bounds")
        database.execute(statement)
    assert failed(campaign) == ["header"]


def test_rows_that_stand_there_twice(campaign: Path) -> None:
    with editing(campaign) as database:
        columns = "seq, problem, test, upper, lower, stopped_by, block"
        database.execute("ALTER TABLE bounds RENAME TO once")
        database.execute("CREATE TABLE bounds (seq, problem, test, upper, lower, stopped_by, block)")
        database.execute(f"INSERT INTO bounds SELECT {columns} FROM once")
        database.execute(f"INSERT INTO bounds SELECT -{columns} FROM once WHERE test = 3")
        database.execute("DROP TABLE once")
    assert "repeated" in check(campaign).found["database"].detail


def test_a_rollout_of_a_test_that_nobody_proposed(campaign: Path) -> None:
    with editing(campaign) as database:
        database.execute(
            "INSERT INTO rollouts (seq, problem, test, variant, replicate, seed, sha256, size, path, robustness, "
            "by_tolerance, block) SELECT 9999, problem, 77, variant, replicate, seed, sha256, size, path, -1, 0, 77 "
            "FROM rollouts WHERE test = 3 LIMIT 1"
        )
    assert failed(campaign) == ["database"]


def test_rollouts_in_flight_when_their_problem_stopped_have_their_seeds(campaign: Path) -> None:
    """As if test 7 had been proposed and simulated, and not awaited."""
    there = read_untrusted(campaign)

    def last(fact: StoredFact) -> bool:
        assert not isinstance(fact, ExtensionFact)
        if isinstance(fact, RolloutFact | BatchFact | DiscardFact):
            return fact.rollout[:2] == ("sim_gap", 7)
        return (fact.problem, fact.test) == ("sim_gap", 7)

    early = UntrustedFacts(
        there.header,
        there.proposals,
        there.rollouts,
        (),
        tuple(fact for fact in there.observations if not last(fact)),
        tuple(fact for fact in there.bounds if not last(fact)),
        (),
    )
    derived: list[StoredFact] = [*there.proposals, *early.observations, *early.bounds]
    derived += [fact for fact in there.rollouts if not last(fact)]
    assert compare.tables(there.header, derived, early)[0] is None
    alone = [fact for fact in there.rollouts if isinstance(fact, RolloutFact)]
    other = tuple(replace(fact, seed=fact.seed + 1) if last(fact) else fact for fact in alone)
    fault, _ = compare.tables(there.header, derived, replace(early, rollouts=other))
    assert fault is not None
    assert "sim_gap.7" in fault


def respecify(directory: Path, edit: Callable[[Any], object]) -> None:
    """Edit the system in the database, with its digest in the certificate."""
    with editing(directory) as database:
        (text,) = database.execute("SELECT system FROM campaign").fetchone()
        value = json.loads(text)
        edit(value)
        new = canonical_json(value)
        database.execute("UPDATE campaign SET system = ?", (new,))
    digest = SystemSpec.model_validate_json(new).digest
    rewrite(directory, lambda predicate: predicate["campaign"].update(system_sha256=digest))


@pytest.mark.parametrize(
    ("edit", "line"),
    [
        (lambda spec: spec.update(name="autopilot"), "header"),
        (lambda spec: spec["parameters"][0].update(high=4.0), "header"),
        (lambda spec: spec["parameters"][0].update(unit="km"), "header"),
        (lambda spec: spec.update(noisy=[], disturbances=[], residual=True), "requests"),
        (lambda spec: spec.update(doc="certified"), "requests"),
    ],
)
def test_a_campaign_of_another_system(campaign: Path, edit: Callable[[Any], object], line: str) -> None:
    respecify(campaign, edit)
    assert failed(campaign) == [line]


def test_the_certificate_names_the_system(campaign: Path) -> None:
    rewrite(campaign, lambda predicate: predicate["campaign"].update(system_sha256="0" * 64))
    assert failed(campaign) == ["header"]


@pytest.mark.parametrize("kept", [slice(0, 1), slice(0, -30)])
def test_a_trajectory_that_was_cut(campaign: Path, kept: slice) -> None:
    altered(of(campaign, "nominal_robustness", 7, "nominal"), numbers=lambda samples: samples[kept])
    relist(campaign)
    assert failed(campaign) == ["trajectories"]


@pytest.mark.rest
@pytest.mark.integration
def test_a_resimulation_that_cannot_be_done_is_no_pass(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: str, **__: object) -> str:
        raise PerfboundError("the system is not installed")

    monkeypatch.setattr(simulate, "ask", missing)
    found = verify_certificate(campaign, key=None, again=2, report=lambda *_: None).checks
    assert found.found["resimulation"].status == "failed"


def test_what_a_stranger_wrote_is_shown_and_not_obeyed(campaign: Path) -> None:
    with editing(campaign) as database:
        database.execute("UPDATE rollouts SET path = path || char(27) || '[2J' WHERE test = 3")
    console = Console(file=io.StringIO(), width=300, force_terminal=False)
    show.print_verification(Verification(check(campaign), None, None), console)
    assert isinstance(console.file, io.StringIO)
    assert "\x1b" not in console.file.getvalue()
    assert "NOT VERIFIED" in console.file.getvalue()


# Another CPU, and dishonest workers


def test_numbers_of_another_cpu_are_the_same(campaign: Path) -> None:
    """mu and sigma with other last digits, and a chain over them."""
    with editing(campaign) as database:
        assert database.execute("UPDATE tests SET mu = mu * (1 + 3e-14), sigma = sigma * (1 - 3e-14)").rowcount > 0
        database.execute("UPDATE bounds SET upper = upper * (1 + 3e-14)")
    there = read_untrusted(campaign)
    head = compare.chain_head(there.header, [*there.proposals, *there.rollouts, *there.observations], there.proposals)
    rewrite(campaign, lambda predicate: predicate["evidence"].update(chain_head=head))
    assert check(campaign).good


def test_a_rival_of_the_maximiser_is_followed(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """This CPU would choose otherwise; what the campaign tested is within 1e-9 of the maximum, and that is good."""
    monkeypatch.setattr(
        "perfbound.orchestrator.mathematics.bounds.paper.method.maximiser", lambda values: int(values.argsort()[-40])
    )
    text = (campaign / files.MANIFEST).read_text()
    with reading(campaign) as connection:
        header = read_header(connection, campaign)
    rerun = Rerun(campaign, header, parse_manifest(text))
    rerun.play(lambda _: None)
    assert rerun.ties > 0
    assert rerun.ledger.done


@pytest.mark.rest
def test_a_consistent_lie_is_caught_by_simulating_again(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With all rights a consistent campaign can be forged; only the simulation again shows it."""
    files_then = {path.name: path.read_bytes() for path in some_files(campaign)}
    target = of(campaign, "nominal_robustness", 7, "nominal")
    altered(target, numbers=lambda samples: np.column_stack((samples[:, 0], 1.01 * samples[:, 1:])))
    relist(campaign)
    with editing(campaign) as database:
        for name in ("tests", "rollouts", "observations", "bounds"):
            database.execute(f"DELETE FROM {name}")
    with reading(campaign) as connection:
        header = read_header(connection, campaign)
    entries = parse_manifest((campaign / files.MANIFEST).read_text())
    rerun = Rerun(campaign, header, entries)
    rerun.play(lambda _: None)
    ledger, found = rerun.ledger, manifest(rerun.observed())
    files.write(campaign, issue(ledger, found), found.text)
    assert check(campaign).good, "the forgery is complete"

    def simulated(_command: str, _flag: str, request: str, _out: str, out: str, **_: object) -> str:
        wanted = json.loads(request)
        name = f"{wanted['problem']}.{wanted['test']}.{wanted['variant']}.{wanted['replicate']}.mcap"
        Path(out).write_bytes(files_then[name])
        return ""

    monkeypatch.setattr(simulate, "ask", simulated)
    found_again = verify_certificate(campaign, key=None, again=len(entries), report=lambda *_: None).checks
    assert found_again.found["resimulation"].status == "failed"
    assert target.stem in found_again.found["resimulation"].detail
    honest = verify_certificate(campaign, key=None, again=0, report=lambda *_: None).checks
    assert honest.found["resimulation"].status == "skipped"


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        (1.0, 1.0 + 1e-9, True),
        (1.0, 1.0 + 1e-8, False),
        (0, False, False),
        (None, 0.0, False),
        (1, 1.0, False),
        ("0.123456", "0.123457", False),
        ("derived", "assumed", False),
        ([1.0], [1.0, 2.0], False),
        ({"a": None}, {}, False),
        ({"a": 1}, {"a": 1, "b": 2}, False),
    ],
)
def test_what_is_the_same(a: object, b: object, *, same: bool) -> None:
    assert (compare.difference({"v": a}, {"v": b}) is None) is same


@pytest.mark.parametrize(
    ("a", "b", "same"), [(0.123456, 0.123457, True), (0.123456, 0.12347, False), (177, 178, False), (3, 3.0, False)]
)
def test_values_may_differ_in_their_last_digit(a: float, b: float, *, same: bool) -> None:
    assert (compare.difference(a, b, tolerance=compare.SIX_DIGITS) is None) is same


def test_a_stage_of_one_step_has_no_share_before_its_end() -> None:
    """Else its bar shows 0 % for seconds, as if nothing happened."""
    progress = Progress(disable=True)
    report = stage_bars(progress)
    shown = []
    for stage, done, total in (("campaign", 0, 1), ("digests", 0, 7), ("digests", 3, 7), ("campaign", 1, 1)):
        report(stage, done, total)
        shown.append([(each.description, each.completed, each.total) for each in progress.tasks])
    assert shown[0] == [("campaign", 0, None)]
    assert shown[-1] == [("campaign", 1, 1), ("digests", 3, 7)]


def test_an_interrupted_verification_says_what_it_has_checked(campaign: Path) -> None:
    def stops(stage: str, done: int, _: int) -> None:
        if stage == "campaign" and done == 2:
            raise Stopped(2)

    with pytest.raises(Stopped) as stopped:
        verify_certificate(campaign, key=None, again=0, report=stops)
    passed = "certificate header manifest files"
    number = len((campaign / "manifest.sha256").read_text().splitlines())
    missed = (
        "requests trajectories proposals observations stop evidence chain problems probabilities composition "
        "spot check recheck regions claims audit software database attempts resimulation"
    )
    assert says(
        stopped.value.state,
        f"^nothing verified skipped signature passed {passed} campaign at 2 of {number} files not reached {missed}",
    )
