"""Forgeries by someone who knows the code and has no key: each is found, or is listed in the threat model as impossible
to find without a signature, and is found with one.

The campaign has what a forger would want to hide: a trial that failed before it was recorded, so that an assumption is
refuted, and a claim that is not met.
"""

import hashlib
import json
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import perfbound as pb
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.assumptions import sentences
from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.store.attempt_record import table_digests
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.trajectory.trajectory import Trajectory, encode, read_mcap
from tests.tampering import editing

TESTS = 6
OPINION = "kind, rollout, attempt, worker, sha256, at"
SENTENCE = "the norm bound was proven by an expert."


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory beside the keys with which it was signed."""
    folder = tmp_path_factory.mktemp("signed")
    rig = pb.Rig("rig", parameters={"x": pb.Parameter(0, 1, unit="m")}, columns={"y": "m"}, step=0.5)
    keywords: dict[str, Any] = {
        "space": {"x": (0, 1)},
        "specification": "always (y <= 1)",
        "horizon": 1.0,
        "resolution": 5,
        "max_tests": TESTS,
        "alpha": 0.01,
        "delta": 0.05,
        "rkhs_norm": 5,
        "noise_scale": 0.1,
        "clip": (-1, 1),
        "kernel": {"nu": 2.5, "length_scale": 0.5},
        "spot_check": 0,
    }
    with pb.Campaign(rig, **keywords).ask_tell(folder / "run") as study:
        for number in range(TESTS):
            request = study.ask()
            assert request is not None
            if number == 1:
                study.failed(request, "the brake did not engage")
            if number == 2:  # as of workers that were compared
                with sqlite3.connect(folder / "run" / DATABASE) as database:
                    row = ("compared", request.id, 1, "told", "0" * 64, 0.0)
                    database.execute(f"INSERT INTO opinions ({OPINION}) VALUES (?, ?, ?, ?, ?, ?)", row)
                database.close()
            study.tell(request, {"y": np.full(3, 1.2 * request.start["x"])})
    pair = keys.new_pair(folder, "ours")
    sign.sign_certificate(folder / "run", keys.load_private(pair.private))
    return folder


@pytest.fixture
def run(signed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(signed / "run", tmp_path / "run"))


def sql(statement: str) -> Callable[[Path], None]:
    def edit(directory: Path) -> None:
        with editing(directory) as database:
            assert database.execute(statement).rowcount > 0

    return edit


def certificate(change: Callable[[Any], object]) -> Callable[[Path], None]:
    """Change the certificate, and write it and the record of attempts as perfbound would."""

    def edit(directory: Path) -> None:
        value = json.loads((directory / files.CERTIFICATE).read_text())
        change(value["predicate"])
        found = Certificate.model_validate_json(json.dumps(value))
        files.write(directory, found, (directory / files.MANIFEST).read_text(), attempts=table_digests(directory))

    return edit


def both(*edits: Callable[[Path], None]) -> Callable[[Path], None]:
    def edit(directory: Path) -> None:
        for each in edits:
            each(directory)

    return edit


def assumption(name: str, **change: Any) -> Callable[[Any], None]:
    def edit(predicate: Any) -> None:
        next(each for each in predicate["assumptions"] if each["id"].startswith(name)).update(change)

    return edit


def not_refuted(predicate: Any) -> None:
    """As if no trial had failed."""
    calm = sentences.assumption("reproducible_rollouts", "assumed", form="measured").model_dump(mode="json")
    next(each for each in predicate["assumptions"] if each["id"] == "reproducible_rollouts").update(calm)
    for claim in predicate["claims"]:
        claim["refuted"] = [each for each in claim["refuted"] if each != "reproducible_rollouts"]


def manifest(change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    """Change the lines of the manifest, with the digests that follow."""

    def edit(directory: Path) -> None:
        lines = change((directory / files.MANIFEST).read_text().splitlines())
        text = "".join(f"{line}\n" for line in lines)
        (directory / files.MANIFEST).write_text(text)
        value = json.loads((directory / files.CERTIFICATE).read_text())
        sha256 = hashlib.sha256(text.encode()).hexdigest()
        value["subject"][0]["digest"]["sha256"] = sha256
        value["predicate"]["evidence"].update(manifest_sha256=sha256, rollouts=len(lines))
        (directory / files.CERTIFICATE).write_text(Certificate.model_validate_json(json.dumps(value)).to_json())

    return edit


def trajectories(directory: Path) -> list[Path]:
    return sorted((directory / "trajectories").rglob("*.mcap"))


def better_trajectory(directory: Path) -> None:
    """Another trajectory in place of the worst one, in a file as perfbound writes it."""
    path = trajectories(directory)[-1]
    found = read_mcap(path.read_bytes())
    samples = found.trajectory.samples.copy()
    samples[:, 1] = 0.0
    metadata = {name: value for name, value in found.metadata.items() if name != "columns"}
    made = Trajectory(found.trajectory.columns, samples)
    path.write_bytes(encode(made, request=found.request, metadata=metadata, units={"t": "s", "y": "m"}))


def swapped_files(directory: Path) -> None:
    first, second, *_ = trajectories(directory)
    one, other = first.read_bytes(), second.read_bytes()
    first.write_bytes(other)
    second.write_bytes(one)


def unrecorded(directory: Path) -> None:
    for name in (files.ATTEMPTS, files.ATTEMPTS_ENVELOPE):
        (directory / name).unlink()
    sql("DELETE FROM outcomes WHERE kind IS NOT NULL")(directory)


class Forgery(NamedTuple):
    """What is changed, and the check that fails without a key; None where none can."""

    edit: Callable[[Path], None]
    found: str | None


FORGERIES = {
    "a sentence": Forgery(certificate(assumption("rkhs_norm", detail=SENTENCE)), "audit"),
    "the sentence of another form": Forgery(certificate(assumption("rkhs_norm", form="norm_from_tests")), "audit"),
    "a status": Forgery(certificate(assumption("noise_scale", status="derived")), "audit"),
    "a value": Forgery(certificate(lambda p: p["assumptions"][0]["values"].update(b_min=0.001)), "audit"),
    "an assumption less": Forgery(certificate(lambda p: p["assumptions"].pop(0)), "audit"),
    "a larger bound": Forgery(certificate(lambda p: p["claims"][0].update(bound=0.9)), "claims"),
    "a larger probability": Forgery(certificate(lambda p: p["claims"][0].update(probability=0.999)), "probabilities"),
    "another question": Forgery(certificate(lambda p: p["question"].update(specification="always (y <= 2)")), "header"),
    "other rules in the certificate": Forgery(certificate(lambda p: p.update(rules=2)), "header"),
    "other rules everywhere": Forgery(
        both(sql("UPDATE campaign SET rules = 2"), certificate(lambda p: p.update(rules=2))), "header"
    ),
    "another campaign file": Forgery(sql("UPDATE campaign SET config = replace(config, '<= 1', '<= 2')"), "header"),
    "a robustness": Forgery(sql("UPDATE rollouts SET robustness = 0.5 WHERE test = 5"), "database"),
    "an observation": Forgery(sql("UPDATE observations SET y = -0.5 WHERE test = 5"), "database"),
    "swapped rows": Forgery(
        sql("UPDATE rollouts SET seed = (SELECT seed FROM rollouts AS o WHERE o.test = 5 - rollouts.test)"), "database"
    ),
    "swapped files": Forgery(swapped_files, "files"),
    "another trajectory": Forgery(better_trajectory, "files"),
    "a line of the manifest less": Forgery(manifest(lambda lines: lines[:-1]), "stop"),
    "a line of the manifest twice": Forgery(manifest(lambda lines: [*lines, lines[-1]]), "manifest"),
    "a failed attempt less": Forgery(sql("DELETE FROM outcomes WHERE kind IS NOT NULL"), "attempts"),
    "another worker": Forgery(sql("UPDATE attempts SET worker = 'ours'"), "attempts"),
    "an opinion less": Forgery(sql("DELETE FROM opinions"), "attempts"),
    "a status that is better than the tables": Forgery(certificate(not_refuted), "audit"),
    "a sentence of another version": Forgery(
        both(
            sql('UPDATE campaign SET software = replace(software, \'"perfbound":"0.2\', \'"perfbound":"0.1\')'),
            certificate(lambda p: p["software"].update(perfbound="0.1.0")),
            certificate(assumption("rkhs_norm", detail=SENTENCE)),
        ),
        None,  # said in the table: its sentences are not compared, and one is worded otherwise
    ),
    # All of it again, without what is hidden: nothing but a signature says which of the two was issued.
    "a failed attempt less, in all tables": Forgery(
        both(sql("DELETE FROM outcomes WHERE kind IS NOT NULL"), certificate(not_refuted)), None
    ),
    "a failed attempt less, and no record": Forgery(both(certificate(not_refuted), unrecorded), None),
}


def failed(directory: Path, key: Path | None = None) -> list[str]:
    found = verify_certificate(directory, key=key, again=0, report=lambda *_: None).checks
    return [line.name for line in found.lines() if line.status == "failed"]


def test_the_campaign_is_whole(signed: Path, run: Path) -> None:
    assert failed(run) == []
    assert failed(run, signed / "ours.pub") == []
    found = files.read(run)
    assert found is not None
    statuses = {each.id.partition("/")[0]: each.status for each in found.predicate.assumptions}
    assert statuses["reproducible_rollouts"] == "refuted"


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forgery_is_found(signed: Path, run: Path, name: str) -> None:
    edit, line = FORGERIES[name]
    edit(run)
    assert (line in failed(run)) if line else failed(run) == []
    assert failed(run, signed / "ours.pub"), "found with a signature"


def test_without_the_record_a_verification_with_a_key_fails(signed: Path, run: Path) -> None:
    (run / files.ATTEMPTS).unlink()
    assert failed(run, signed / "ours.pub") == [], "the envelope has it"
    (run / files.ATTEMPTS_ENVELOPE).unlink()
    assert failed(run, signed / "ours.pub") == ["attempts"]
    assert failed(run) == []


def test_attempts_after_the_certificate_are_no_fault(run: Path) -> None:
    sql("INSERT INTO attempts SELECT rollout, 99, worker, host, pid, session, started FROM attempts LIMIT 1")(run)
    assert failed(run) == []


def test_what_is_shown_are_the_sentences_of_the_forms(run: Path) -> None:
    true = files.read(run)
    assert true is not None
    certificate(assumption("rkhs_norm", detail=SENTENCE))(run)
    assert SENTENCE in (run / files.CERTIFICATE).read_text()
    assert files.read(run) == true
    certificate(assumption("rkhs_norm", detail=SENTENCE, form="none"))(run)
    shown = files.read(run)
    assert shown is not None
    assert shown.predicate.assumptions[0].detail.startswith("(the certificate was edited")
