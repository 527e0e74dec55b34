"""Keys, envelopes and signatures; securesystemslib is the other side that has to agree."""

import base64
import hashlib
import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from hypothesis import given
from hypothesis import strategies as st
from securesystemslib.dsse import Envelope as TheirEnvelope
from securesystemslib.exceptions import VerificationError
from securesystemslib.signer import CryptoSigner, SSlibKey  # type: ignore[attr-defined]

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.signing import sign
from perfbound.orchestrator.certificate.signing.key_folder import key_folder
from perfbound.orchestrator.certificate.signing.keys import key_id, load_private, load_public, new_pair
from perfbound.orchestrator.cli import signing
from perfbound.orchestrator.cli.group import cli
from perfbound.schemas.errors import EvidenceError, PerfboundError, SignatureError
from perfbound.schemas.result.certificate import (
    MAX_SIGNATURES,
    PAYLOAD_TYPE,
    CampaignId,
    Certificate,
    CertificateClaim,
    DsseEnvelope,
    Evidence,
    Predicate,
    Signature,
    Subject,
)
from tests.campaigns import FOLDER
from tests.facts import says

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OTHER = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))
PAYLOAD = b'{"claim": "rho* >= 0.5"}\n'
MANIFEST = "ab" * 32 + "  trajectories/a.mcap\n"


def changed(envelope: bytes, **fields: Any) -> bytes:
    """Return an envelope with other fields; None removes one."""
    found = json.loads(envelope) | fields
    return json.dumps({key: value for key, value in found.items() if value is not None}).encode()


def resigned(envelope: bytes, **fields: Any) -> bytes:
    """Return an envelope whose signature has other fields."""
    (signature,) = json.loads(envelope)["signatures"]
    return changed(envelope, signatures=[{k: v for k, v in (signature | fields).items() if v is not None}])


ENVELOPE = sign.sign(PAYLOAD, KEY)
SIG = json.loads(ENVELOPE)["signatures"][0]["sig"]


# Envelopes


def test_what_is_signed_is_the_example_of_the_specification() -> None:
    expected = b"DSSEv1 29 http://example.com/HelloWorld 11 hello world"
    assert sign.pae("http://example.com/HelloWorld", b"hello world") == expected


def test_lengths_count_bytes() -> None:
    assert sign.pae("é", b"\xc3\xa9") == b"DSSEv1 2 \xc3\xa9 2 \xc3\xa9"


def test_the_payload_comes_back_byte_by_byte() -> None:
    assert sign.signed_payload(ENVELOPE, KEY.public_key()) == PAYLOAD


def test_a_signature_of_the_same_is_the_same() -> None:
    """The bytes are pinned: an envelope that was published must be the one that is made tomorrow."""
    assert sign.sign(PAYLOAD, KEY) == ENVELOPE
    assert hashlib.sha256(ENVELOPE).hexdigest() == "3dc32294bc9b64b5c04d37ffc85c08551ee74f4a1b3b5b91bff3f7b3d9c6580d"


def test_any_flipped_bit_is_noticed() -> None:
    """All of them, one by one."""
    accepted = []
    for bit in range(len(ENVELOPE) * 8):
        flipped = bytearray(ENVELOPE)
        flipped[bit // 8] ^= 1 << bit % 8
        try:
            sign.signed_payload(bytes(flipped), KEY.public_key())
        except SignatureError:
            continue
        accepted.append(bit)
    assert accepted == []


@given(st.integers(0, len(ENVELOPE)), st.integers(0, 40), st.binary(max_size=40))
def test_what_was_cut_or_pasted_is_refused_or_says_the_same(start: int, length: int, piece: bytes) -> None:
    """White space between two tokens is all that may be added."""
    patched = ENVELOPE[:start] + piece + ENVELOPE[start + length :]
    try:
        assert sign.signed_payload(patched, KEY.public_key()) == PAYLOAD
    except SignatureError:
        return
    assert json.loads(patched) == json.loads(ENVELOPE)


@pytest.mark.rest
@given(
    st.binary() | st.text().map(str.encode) | st.recursive(st.none(), st.lists).map(lambda v: json.dumps(v).encode())
)
def test_what_is_no_envelope_is_one_known_error(text: bytes) -> None:
    with pytest.raises(SignatureError):
        sign.signed_payload(text, KEY.public_key())


@pytest.mark.parametrize(
    ("envelope", "fault"),
    [
        (b"", "not a DSSE envelope"),
        (b"\xff", "not a DSSE envelope"),
        (b"[" * 100_000, "not a DSSE envelope"),
        (b'{"payload": 1e999}', "not a DSSE envelope"),
        (ENVELOPE.decode().encode("utf-16"), "not a DSSE envelope"),
        (changed(ENVELOPE, payload=None), "payload: Field required"),
        (changed(ENVELOPE, payload=7), "payload: Input should be a valid string"),
        (changed(ENVELOPE, payload="\ud800"), "payload of the envelope is not base64"),
        (changed(ENVELOPE, more=7), "more: Extra inputs are not permitted"),
        (resigned(ENVELOPE, cert="x"), "signatures.0.cert: Extra inputs"),
        (changed(ENVELOPE, signatures=[]), "signatures: "),
        (changed(ENVELOPE, signatures=[Signature(sig="").model_dump()] * (MAX_SIGNATURES + 1)), "signatures: "),
        (changed(ENVELOPE, signatures={}), "signatures: "),
        (changed(ENVELOPE, payloadType="application/json"), "contains 'application/json'"),
        (changed(ENVELOPE, payload=base64.b64encode(PAYLOAD + b" ").decode()), "does not fit"),
        (changed(ENVELOPE, payload=base64.b64encode(PAYLOAD).decode().rstrip("=")), "payload of the envelope is not"),
        (changed(ENVELOPE, payload=base64.b64encode(PAYLOAD).decode() + "\n"), "payload of the envelope is not base64"),
        (changed(ENVELOPE, payload="é"), "payload of the envelope is not base64"),
        (resigned(ENVELOPE, sig=SIG[:-4]), "does not fit"),
        (resigned(ENVELOPE, sig=""), "does not fit"),
        (resigned(ENVELOPE, sig=SIG[:-3] + "B=="), "signature base64"),
        (resigned(ENVELOPE, keyid="f" * 64), "no signature by key"),
        (ENVELOPE.replace(b'"payload":', b'"payload": "", "payload":', 1), "a key is repeated"),
        (ENVELOPE + b" " * sign.MAX_ENVELOPE, "more than"),
    ],
)
def test_a_fault_is_named(envelope: bytes, fault: str) -> None:
    with pytest.raises(SignatureError) as error:
        sign.signed_payload(envelope, KEY.public_key())
    assert says(str(error.value), fault)
    assert "\n" not in str(error.value)


def test_a_key_id_is_a_hint_that_may_be_missing() -> None:
    """DSSE: unset is the same as empty, and means that nothing is known of the key."""
    for hint in (None, ""):
        assert sign.signed_payload(resigned(ENVELOPE, keyid=hint), KEY.public_key()) == PAYLOAD
        with pytest.raises(SignatureError, match="does not fit"):
            sign.signed_payload(resigned(ENVELOPE, keyid=hint), OTHER.public_key())


def test_the_id_of_the_right_key_makes_no_signature_right() -> None:
    forged = resigned(sign.sign(PAYLOAD, OTHER), keyid=key_id(KEY.public_key()))
    with pytest.raises(SignatureError, match="does not fit"):
        sign.signed_payload(forged, KEY.public_key())


def test_base64_may_be_url_safe_and_not_mixed() -> None:
    payload = b"\xfb\xff\xbe\xff"  # ++/+ and //8= of the standard alphabet
    found = sign.sign(payload, KEY)
    standard = json.loads(found)["payload"]
    safe = base64.urlsafe_b64encode(payload).decode()
    assert {"+", "/"} <= set(standard)
    assert sign.signed_payload(changed(found, payload=safe), KEY.public_key()) == payload
    with pytest.raises(SignatureError, match="not base64"):
        sign.signed_payload(changed(found, payload=standard.replace("+", "-")), KEY.public_key())


def test_another_type_is_refused_although_its_signature_holds() -> None:
    signature = KEY.sign(sign.pae("text/plain", PAYLOAD))
    envelope = resigned(changed(ENVELOPE, payloadType="text/plain"), sig=base64.b64encode(signature).decode())
    with pytest.raises(SignatureError, match="contains 'text/plain'"):
        sign.signed_payload(envelope, KEY.public_key())


def test_of_several_signatures_one_has_to_be_by_the_key() -> None:
    both = sign.sign(PAYLOAD, OTHER, DsseEnvelope.model_validate(json.loads(ENVELOPE)).signatures)
    assert sign.signed_payload(both, KEY.public_key()) == sign.signed_payload(both, OTHER.public_key()) == PAYLOAD
    with pytest.raises(SignatureError, match="no signature by key"):
        sign.signed_payload(both, Ed25519PrivateKey.generate().public_key())


# The other side


def test_both_sides_give_a_key_the_same_id() -> None:
    assert key_id(KEY.public_key()) == SSlibKey.from_crypto(KEY.public_key()).keyid


def test_they_accept_what_we_sign() -> None:
    theirs = SSlibKey.from_crypto(KEY.public_key())
    found = TheirEnvelope.from_dict(json.loads(ENVELOPE))
    assert found.verify([theirs], 1) == {theirs.keyid: theirs}
    assert (found.payload, found.payload_type) == (PAYLOAD, PAYLOAD_TYPE)
    with pytest.raises(VerificationError):
        TheirEnvelope.from_dict(json.loads(ENVELOPE)).verify([SSlibKey.from_crypto(OTHER.public_key())], 1)


@given(st.binary(max_size=300))
def test_we_accept_what_they_sign(payload: bytes) -> None:
    theirs = TheirEnvelope(payload, PAYLOAD_TYPE, {})
    theirs.sign(CryptoSigner(KEY))
    text = json.dumps(theirs.to_dict()).encode()
    assert sign.signed_payload(text, KEY.public_key()) == payload
    assert json.loads(text) == json.loads(sign.sign(payload, KEY)), "both make the same envelope"


def test_they_read_our_keys(tmp_path: Path) -> None:
    pair = new_pair(tmp_path, "k")
    signer = CryptoSigner.from_priv_key_uri(f"file2:{pair.private}", SSlibKey.from_crypto(load_public(pair.public)))
    assert signer.public_key.keyid == pair.id


# Keys


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_key_is_for_its_owner_alone(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        pair = new_pair(tmp_path, "k")
    finally:
        os.umask(before)
    assert (mode(pair.private), mode(pair.public)) == (0o600, 0o644)
    assert sorted(os.listdir(tmp_path)) == ["k.key", "k.pub"]
    assert key_id(load_private(pair.private).public_key()) == key_id(load_public(pair.public)) == pair.id


@pytest.mark.parametrize("there", ["k.key", "k.pub"])
def test_a_key_is_never_overwritten(tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_text("mine")
    with pytest.raises(SignatureError, match=f"{there}: exists already"):
        new_pair(tmp_path, "k")
    assert (tmp_path / there).read_text() == "mine"
    assert os.listdir(tmp_path) == [there]


def test_a_key_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SignatureError, match="No space left on device"):
        new_pair(tmp_path, "k")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("bits", [0o604, 0o640, 0o620, 0o601])
def test_a_private_key_that_others_can_open_is_refused(tmp_path: Path, bits: int) -> None:
    pair = new_pair(tmp_path, "k")
    pair.private.chmod(bits)
    with pytest.raises(SignatureError, match=rf"mode {bits:04o}.*chmod 600"):
        load_private(pair.private)
    pair.private.chmod(0o400)
    load_private(pair.private)


def test_a_secret_that_another_user_shares_with_our_group_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that a container's mounted secret (root, 0440) can be used: as ssh does it."""
    pair = new_pair(tmp_path, "k")
    pair.private.chmod(0o440)
    monkeypatch.setattr(os, "geteuid", lambda: pair.private.stat().st_uid + 1)
    load_private(pair.private)
    pair.private.chmod(0o444)
    with pytest.raises(SignatureError, match="others can read"):
        load_private(pair.private)


def test_a_passphrase_is_needed_and_has_to_be_the_right_one(tmp_path: Path) -> None:
    pair = new_pair(tmp_path, "k", b"secret")
    assert b"ENCRYPTED" in pair.private.read_bytes()
    assert key_id(load_private(pair.private, lambda: b"secret").public_key()) == pair.id
    for wrong in (b"Secret", b""):
        with pytest.raises(SignatureError, match="not the passphrase"):
            load_private(pair.private, lambda wrong=wrong: wrong)  # type: ignore[misc]


def test_nobody_is_asked_without_need(tmp_path: Path) -> None:
    def ask() -> bytes:
        raise AssertionError("the key is not encrypted")

    load_private(new_pair(tmp_path, "k").private, ask)


def private_pem(key: rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (b"", "empty"),
        (b"x", "not a private key"),
        (b"x" * 70_000, "more than 65536 bytes"),
        (b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n", "not a private key"),
        (private_pem(ec.generate_private_key(ec.SECP256R1())), "not an Ed25519 key"),
        (KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo), "this is a public key"),
    ],
)
def test_what_is_no_private_key_is_refused(tmp_path: Path, text: bytes, fault: str) -> None:
    path = tmp_path / "k"
    path.write_bytes(text)
    path.chmod(0o600)
    with pytest.raises(SignatureError, match=f"{path}: .*{fault}"):
        load_private(path)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (b"x", "not a public key"),
        (b"-----BEGIN PUBLIC KEY-----\nAAAA\n-----END PUBLIC KEY-----\n", "not a public key"),
        (KEY.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), "this is a private key"),
        (
            ec.generate_private_key(ec.SECP256R1())
            .public_key()
            .public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo),
            "not an Ed25519 key",
        ),
    ],
)
def test_what_is_no_public_key_is_refused(tmp_path: Path, text: bytes, fault: str) -> None:
    path = tmp_path / "k"
    path.write_bytes(text)
    with pytest.raises(SignatureError, match=f"{path}: .*{fault}"):
        load_public(path)


@pytest.mark.parametrize("load", [load_private, load_public])
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, load: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, fault in (("pipe", "not a file"), ("none", "No such file"), (".", "directory")):
        with pytest.raises(SignatureError, match=fault):
            load(tmp_path / name)


# A run directory


def finished(directory: Path) -> Path:
    """Leave what a finished campaign leaves, as far as a signature is concerned."""
    claim = CertificateClaim(
        quantity="J_star",
        sense="<=",
        bound=0.5,
        probability=0.9,
        rule="single",
        method="paper",
        assumptions=(),
        refuted=(),
    )
    digest = hashlib.sha256(MANIFEST.encode()).hexdigest()
    predicate = Predicate(
        question={},
        campaign=CampaignId(name="c", seed=1, config_sha256="0" * 64, system_sha256="0" * 64),
        claims=(claim,),
        problems=(),
        composition=None,
        assumptions=(),
        evidence=Evidence(manifest_sha256=digest, chain_head="0" * 64, rollouts=1),
        software={},
        rules=1,
    )
    subject = Subject(name=files.MANIFEST, digest={"sha256": digest})
    directory.mkdir()
    files.write(directory, Certificate(subject=(subject,), predicate=predicate), MANIFEST)
    return directory


def test_a_certificate_is_signed_as_it_stands(tmp_path: Path) -> None:
    directory = finished(tmp_path / "run")
    before = (directory / files.CERTIFICATE).read_bytes()
    path = sign.sign_certificate(directory, KEY)
    assert path == directory / "certificate.dsse.json"
    assert (
        sign.signed_payload(path.read_bytes(), KEY.public_key())
        == before
        == (directory / files.CERTIFICATE).read_bytes()
    )
    assert json.loads(before)["_type"] == "https://in-toto.io/Statement/v1"


def test_signatures_of_others_stay_and_signing_again_changes_nothing(tmp_path: Path) -> None:
    directory = finished(tmp_path / "run")
    for key in (KEY, OTHER):
        path = sign.sign_certificate(directory, key)
    both, written = path.read_bytes(), path.stat().st_mtime_ns
    for key in (OTHER, KEY):
        sign.sign_certificate(directory, key)
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (both, written)
    for key in (KEY, OTHER):
        sign.signed_payload(both, key.public_key())


def test_nothing_is_signed_before_there_is_a_certificate(tmp_path: Path) -> None:
    with pytest.raises(EvidenceError, match=r"no certificate\.json to sign"):
        sign.sign_certificate(tmp_path, KEY)


def test_a_damaged_certificate_is_not_signed(tmp_path: Path) -> None:
    directory = finished(tmp_path / "run")
    (directory / files.CERTIFICATE).write_text("{}")
    with pytest.raises(EvidenceError, match="not a certificate"):
        sign.sign_certificate(directory, KEY)


def test_a_certificate_of_other_evidence_is_not_signed(tmp_path: Path) -> None:
    directory = finished(tmp_path / "run")
    (directory / files.MANIFEST).write_text(MANIFEST.replace("ab", "cd"))
    with pytest.raises(EvidenceError, match="does not match the manifest"):
        sign.sign_certificate(directory, KEY)
    assert not (directory / files.ENVELOPE).exists()


@pytest.mark.parametrize(
    ("envelope", "fault"),
    [(ENVELOPE, "is not of certificate.json"), (b"{}", "not a DSSE envelope"), (b"", "not a DSSE envelope")],
)
def test_an_envelope_of_something_else_is_not_replaced(tmp_path: Path, envelope: bytes, fault: str) -> None:
    directory = finished(tmp_path / "run")
    (directory / files.ENVELOPE).write_bytes(envelope)
    with pytest.raises(SignatureError, match=rf"certificate.dsse.json: {fault}.*remove it"):
        sign.sign_certificate(directory, KEY)
    assert (directory / files.ENVELOPE).read_bytes() == envelope


# Commands


def command(*arguments: str | Path, **environment: str) -> Result:
    return CliRunner().invoke(cli, [str(each) for each in arguments], env=environment)


def refused(result: Result) -> str:
    """Return the one line of a known error."""
    assert isinstance(result.exception, PerfboundError), result.output
    return str(result.exception)


def test_keygen_and_sign_say_what_they_made(tmp_path: Path) -> None:
    directory = finished(tmp_path / "run")
    made = command("keygen", "k", "--out", tmp_path)
    key = key_id(load_public(tmp_path / "k.pub"))
    assert made.exit_code == 0
    assert key in made.stdout
    signed = command("sign", directory, "--key", tmp_path / "k.key")
    assert signed.exit_code == 0
    assert key in signed.stdout
    sign.signed_payload((directory / files.ENVELOPE).read_bytes(), load_public(tmp_path / "k.pub"))


def test_a_key_is_made_in_the_folder_for_configurations(tmp_path: Path) -> None:
    place = tmp_path / "new" / "perfbound" / "keys"
    made = command("keygen", "k", XDG_CONFIG_HOME=str(tmp_path / "new"))
    assert (made.exit_code, made.stderr) == (0, "")
    assert f"private key  {place / 'k.key'} " in made.stdout
    assert sorted(os.listdir(place)) == ["k.key", "k.pub"]
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    assert "exists already" in refused(command("keygen", "k", XDG_CONFIG_HOME=str(tmp_path / "new")))
    assert key_folder({"XDG_CONFIG_HOME": "relative", "HOME": "/h"}) == Path.home() / ".config" / "perfbound" / "keys"


def test_a_folder_for_configurations_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    fault = refused(command("keygen", "k", XDG_CONFIG_HOME=str(tmp_path / "file")))
    assert says(fault, f"^{tmp_path / 'file' / 'perfbound' / 'keys'}: folder --out")


@pytest.mark.parametrize("kind", ["folder", "file", "none"])
def test_a_key_in_a_git_work_tree_is_warned_about(tmp_path: Path, kind: str) -> None:
    tree = tmp_path / "project"
    (tree / "deep").mkdir(parents=True)
    if kind != "none":
        (tree / ".git").mkdir() if kind == "folder" else (tree / ".git").write_text("gitdir: elsewhere\n")
    (tmp_path / "link").symlink_to(tree / "deep")
    for name, out in (("a", tree / "deep"), ("b", tmp_path / "link")):
        made = command("keygen", name, "--out", out)
        assert made.exit_code == 0
        found = f"perfbound: {out / name}.key: is in the git work tree {tree} and may be committed; "
        assert made.stderr == ("" if kind == "none" else f"{found}move this private key elsewhere\n")


@pytest.mark.parametrize("name", ["", "../k", "a/b", ".k", "-", "k\n", "x" * 65])
def test_a_name_is_no_path(tmp_path: Path, name: str) -> None:
    assert command("keygen", "--out", tmp_path, "--", name).exit_code == 2
    assert os.listdir(tmp_path) == []


def test_a_passphrase_is_typed_or_stands_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory, secret = finished(tmp_path / "run"), tmp_path / "secret"
    secret.write_text("correct horse\n")
    secret.chmod(0o600)
    assert command("keygen", "k", "--passphrase", "--out", tmp_path, **{signing.FROM_FILE: str(secret)}).exit_code == 0
    load_private(tmp_path / "k.key", lambda: b"correct horse")
    ask = ("sign", directory, "--key", tmp_path / "k.key")
    assert "this is no terminal" in refused(command(*ask))
    assert command(*ask, **{signing.FROM_FILE: str(secret)}).exit_code == 0
    secret.chmod(0o644)
    assert "others can read this file" in refused(command(*ask, **{signing.FROM_FILE: str(secret)}))
    secret.chmod(0o600)
    secret.write_text("\n")
    assert "first line is empty" in refused(command(*ask, **{signing.FROM_FILE: str(secret)}))


@pytest.mark.parametrize("first", ["run", "orchestrate"])
def test_a_key_is_looked_at_before_the_campaign_starts(tmp_path: Path, first: str) -> None:
    campaign = FOLDER / "test-function.toml"
    result = command(first, campaign, "--out", tmp_path / "run", "--sign", tmp_path / "none")
    assert "none: No such file" in refused(result)
    assert os.listdir(tmp_path) == []
