# SPDX-License-Identifier: Apache-2.0
"""``keymint request``: a robot makes its key, and asks for a certificate."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Mapping
from pathlib import Path

import click

from comarmor.values import replace
from keymint.api import KeySpec
from keymint.command_line.named_files import deliver
from keymint.command_line.robot_options import folder_option, keystore_of, opened_store
from keymint.command_line.verb import FILE, Report, Run, argument, flag, option, path_option, verb
from keymint.errors import KeymintError, Origin
from keymint.names import package_name, subject_of
from keymint.pki import certificates, keys
from keymint.pki.distinguished_names import common_name
from keymint.pki.tokens.token_sessions import PIN_VARIABLE
from keymint.robots import certification_request as requests
from keymint.robots.bundle import CERTIFICATE, KEY
from keymint.robots.robot_keystore import Keystore

_KINDS: Mapping[str, KeySpec] = {
    "P-256": KeySpec("ec", curve="SECP256R1"),
    "RSA-2048": KeySpec("rsa", size=2048),
    "RSA-3072": KeySpec("rsa", size=3072),
}


@verb(workspace=False)
def request(
    run: Run,
    name: str = argument(),
    output: Path | None = path_option("-o", kind=FILE),
    folder: Path | None = folder_option,
    rekey: bool = flag(),
    discard: bool = flag(),
    key_type: str = option(type=click.Choice(list(_KINDS)), default="P-256", show_default=True),
    uri: str = option("--pkcs11", metavar="URI", default=""),
    pin_env: str = option(
        metavar="VARIABLE", default="", help=f"Environment variable of the token's PIN [{PIN_VARIABLE}]."
    ),
) -> Report:
    """Ask for a certificate, on the robot: make a key that never leaves it, and a request to carry to the authority.

    Needs no workspace. NAME is the enclave, e.g. /robot1/talker. Tell the authority the printed fingerprint over
    another channel than the request, e.g. by telephone: whoever carries the request could exchange it.

    An enclave that has a key keeps it, and that key signs the request; with --rekey, the old key signs it. Then the
    authority needs no fingerprint.

    With --pkcs11 no key is made: the key is in a token of this robot, which signs the request. Name the same URI in
    the sources of the enclave's package, so that its node finds the key.

    Until a request is answered, the same command writes it again.

    Options:
        output: The request [NAME.request.pem].
        rekey: Make a new key for an enclave that has one; the old one signs the request.
        discard: Discard a request that waits for its answer, with its key.
        key_type: Kind of a new key.
        uri: URI of a key in a token (RFC 7512).
    """
    name = package_name(name)
    keystore = keystore_of(run, folder)
    kind = replace(_KINDS[key_type], uri=uri, pin_env=pin_env)
    with opened_store(run, keystore) as store, contextlib.closing(run.tokens):
        there = keystore_of(run, folder)
        content = None if discard else there.request(name)
        if content is None:
            content, new_key = _made(run, there, name, rekey=rekey, kind=kind)
            store.begin(run.intent())
            store.commit(store.stage([there.wait(name, content, new_key)]))
            there = keystore_of(run, folder)
        elif rekey and not uri and (waiting := there.pending(name)) is not None and not waiting.key:
            message = f"a request of {subject_of(name)} for the key that it has waits for its answer"
            help_ = "carry it to the authority, or add --discard"
            raise KeymintError(message, where=Origin(keystore.shown), help=help_, code="request-waits")
    asked = requests.read(content, Origin(keystore.shown))
    target = output or Path(f"{name.replace('/', '.')}.request.pem")
    delivered = deliver(run, target, content)
    vouched = asked.signer or asked.fingerprint == _certified(there, name)
    run.console.line(f"fingerprint of the key: {asked.fingerprint}")
    told = "" if vouched else f" --fingerprint {subject_of(name)}={asked.fingerprint}"
    run.console.line(f"at the authority:       keymint sign {target.name}{told}")
    run.console.line("with its answer:        keymint accept BUNDLE")
    result = {
        "enclave": subject_of(name), "fingerprint": asked.fingerprint, "signed_by_current_key": bool(vouched),
        **delivered, "keystore": keystore.shown,
    }  # fmt: skip
    return run.report(result)


def _certified(there: Keystore, name: str) -> str:
    """Return the fingerprint of the key that an enclave's certificate is for; empty if it has none."""
    content = there.installed(name).get(CERTIFICATE)
    if content is None:
        return ""
    return certificates.fingerprint(certificates.load(content, Origin(f"{there.shown}/…/{name}")))


def _made(run: Run, there: Keystore, name: str, *, rekey: bool, kind: KeySpec) -> tuple[bytes, bytes]:
    """Return a new request of an enclave, and its private key (PEM) unless the enclave or a token has it.

    Raises:
        KeymintError: the key or the certificate that the enclave has cannot be used; it has another key than the one to
            ask for, and nobody said that it gets a new one; or as a token refuses, see
            :class:`keymint.pki.tokens.token_sessions.Tokens`.
    """
    files = there.installed(name)
    nonce, claimed = secrets.token_hex(requests.NONCE_BYTES), common_name(subject_of(name))
    place = f"{there.shown}/…/{name}"
    present = keys.from_pem(files[KEY], None, Origin(f"{place}/{KEY}")) if KEY in files else None
    where = Origin("--pkcs11")
    token = run.tokens.private_key(kind, run.tokens.public_key(kind, where), where) if kind.uri else None
    certified = _certified(there, name)
    if certified and not rekey and (present is None if token is None else keys.fingerprint(token) != certified):
        raise KeymintError(
            f"the key of {subject_of(name)} is in no file of the keystore"
            if token is None
            else f"the token has another key than {subject_of(name)} has",
            where=Origin(there.shown),
            help="name it with --pkcs11 if it lies in a token, or get a new one with --rekey",
            code="key-elsewhere",
        )
    if present is not None and token is None and not rekey:
        return requests.make(claimed, present, nonce), b""
    current = None
    if present is not None and CERTIFICATE in files:
        current = certificates.Issuer(certificates.load(files[CERTIFICATE], Origin(f"{place}/{CERTIFICATE}")), present)
    if token is not None:
        own = current is not None and keys.matches(token, current.certificate)
        return requests.make(claimed, token, nonce, None if own else current), b""
    key = keys.generate(kind)
    return requests.make(claimed, key, nonce, current), keys.to_pem(key)
