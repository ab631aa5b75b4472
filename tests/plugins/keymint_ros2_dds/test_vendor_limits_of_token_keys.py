# SPDX-License-Identifier: Apache-2.0
"""Identities whose key lies in a token of the robot: ``tests/real/test_keys_in_tokens.py`` asks the vendors."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros2_dds import build_type, vendor_limits
from keymint_ros2_dds.enclave_layout import KEY, KEY_URI, READS_KEY_URI, files
from keymint_ros2_dds.lowering.name_mapping import DISTROS
from keymint_ros2_dds.settings import BUILD_TYPE, settings_of

from comarmor.errors import Severity
from keymint.api import BuildOptions, EnclaveFiles, Package
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.builds import CHATTER

from .enclaves import anchors, credentials, inspection
from .packages import package

URI = "pkcs11:token=robot;object=talker"
STRICT, LENIENT = BuildOptions(), BuildOptions(allow_vendor_specific=True)


def in_token(*, accepted: bool = True, distro: str = "jazzy", uri: str = URI) -> Package:
    own = package(CHATTER, distro=distro)
    settings = {BUILD_TYPE: replace(settings_of(own), accepts_token_keys=accepted)}
    identity = replace(own.identity, key=replace(own.identity.key, uri=uri))
    return replace(own, identity=identity, settings=settings)


def enclave(own: Package) -> dict[str, bytes]:
    documents = build_type.build(own, LENIENT).documents
    issued = replace(credentials(own), key=b"")
    artifacts = build_type.install(own, documents, issued, "sros2", {})
    assert not any(artifact.secret for artifact in artifacts.values())
    return {name: artifact.content for name, artifact in artifacts.items()}


def findings(own: Package, options: BuildOptions) -> list[tuple[str, Severity]]:
    try:
        found = build_type.build(own, options).diagnostics
    except KeymintError as error:
        found = tuple(error.diagnostics)
    return [(each.code, each.severity) for each in found if "key" in each.code]


def test_the_owner_must_say_that_only_fast_dds_runs() -> None:
    code = "portability-key-token"
    assert findings(in_token(accepted=False), STRICT) == [(code, Severity.ERROR)]
    assert findings(in_token(accepted=False), LENIENT) == [(code, Severity.WARNING)]
    assert findings(in_token(), STRICT) == [(code, Severity.NOTE)]
    assert findings(package(CHATTER), STRICT) == []


def test_distributions_read_such_keys_from_jazzy_on() -> None:
    first = [*DISTROS].index("jazzy")
    assert tuple(READS_KEY_URI) == (*DISTROS,)[first:]
    for distro in (*DISTROS,)[:first]:
        if distro != "ardent":  # has names of its own
            assert findings(in_token(distro=distro), LENIENT) == [("key-token-distro", Severity.ERROR)], distro


def test_a_module_is_no_matter_of_the_uri() -> None:
    uri = f"{URI}?module-path=/usr/lib/module.so"
    assert ("key-token-module", Severity.ERROR) in findings(in_token(uri=uri), STRICT)


def test_the_enclave_has_the_uri_in_place_of_the_key() -> None:
    own = in_token()
    written = enclave(own)
    assert written[KEY_URI] == f"{URI}\n".encode()
    assert KEY not in written
    assert KEY_URI in files("sros2")
    assert KEY_URI not in files("flat")


@pytest.mark.parametrize(
    ("content", "code"),
    [(f"{URI}\n", ""), (f"{URI}x\n", "key-uri"), (f" {URI}\n", "key-uri"), ("", "key-uri"), (None, "key-uri")],
)
def test_check_and_prove_compare_the_uri(content: str | None, code: str) -> None:
    own = in_token()
    public = replace(own, issuance=replace(own.issuance, public_key=b""))
    present = {name: each for name, each in enclave(own).items() if name != KEY_URI}
    present |= {} if content is None else {KEY_URI: content.encode()}
    found = [each.code for each in build_type.check(inspection(public, present)) if each.code != "file-missing"]
    assert found == ([code] if code else [])
    wanted = replace(anchors(own), key_uri=URI)
    replaced = [each.code for each in build_type.prover.differences(EnclaveFiles(present, "install/talker", wanted))]
    assert replaced == (["file-replaced"] if code and content is not None else [])


def test_a_uri_that_the_sources_do_not_have_replaces_the_key() -> None:
    own = package(CHATTER)
    present = {name: each for name, each in enclave(in_token()).items() if name != KEY_URI}
    assert "key-uri" not in {each.code for each in build_type.check(inspection(own, present))}
    present[KEY_URI] = f"{URI}\n".encode()
    assert "key-uri" in {each.code for each in build_type.check(inspection(own, present))}
    found = {each.code for each in build_type.prover.differences(EnclaveFiles(present, "", anchors(own)))}
    assert found == {"file-replaced", "file-missing"}  # key.pem, which nodes would read without it


def test_no_uri_is_never_the_one_of_a_file() -> None:
    assert not vendor_limits.is_key_uri(b"\n", "")
    assert not vendor_limits.is_key_uri(None, URI)
