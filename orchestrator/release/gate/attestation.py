"""The attestation of a gate: an in-toto Statement with the predicate test-result, beside the certificates.

Its form is that of https://in-toto.io/attestation/test-result/v0.1: who verifies the artefacts of a release with a
policy of in-toto finds there which rules held of which certificates, and by which file.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from ....schemas.errors import one_line
from ....schemas.result.certificate import STATEMENT_TYPE
from ...certificate import files
from .outputs import UNREADABLE, passed
from .rules import Judgement

PREDICATE_TYPE = "https://in-toto.io/attestation/test-result/v0.1"


def to_attestation(judgements: Sequence[Judgement], policy: Path, rules: bytes) -> bytes:
    """Return the statement on the certificates that were judged by the `rules` in the file `policy`.

    The tests are named RUN: RULE. A certificate that cannot be read has no digest, and is no subject.
    """
    judged = [each for each in judgements if each.subject is not None and each.subject.sha256]
    tests = [
        (f"{one_line(each.name)}: {finding.rule}", finding.passed) for each in judgements for finding in each.findings
    ]
    tests += [(f"{one_line(each.name)}: {UNREADABLE}", False) for each in judgements if each.fault]
    statement = {
        "_type": STATEMENT_TYPE,
        "subject": [
            {"name": f"{one_line(each.name)}/{files.CERTIFICATE}", "digest": {"sha256": each.subject.sha256}}
            for each in judged
            if each.subject is not None
        ],
        "predicateType": PREDICATE_TYPE,
        "predicate": {
            "result": "PASSED" if passed(judgements) else "FAILED",
            "configuration": [{"name": one_line(str(policy)), "digest": {"sha256": hashlib.sha256(rules).hexdigest()}}],
            "passedTests": _distinct(name for name, good in tests if good),
            "failedTests": _distinct(name for name, good in tests if not good),
        },
    }
    return (json.dumps(statement, indent=1) + "\n").encode()


def _distinct(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
