# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.decision.semantics import VARIATIONS, Variation
from keymint_ros2_dds.emit import kind_members

from comarmor.errors import Origin
from keymint.errors import KeymintError
from keymint.pki import certificates, distinguished_names, keys
from tests.keymint.pki.conftest import P256, Openssl, make_spec
from tests.plugins.keymint_ros2_dds.packages import package

HERE = Origin("identities.xml", 3)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["CN", "O", "OU"]),
            st.from_regex(r"[A-Za-z0-9/_.@-]+( [A-Za-z0-9/_.@-]+)?", fullmatch=True).map(lambda v: v[:64].strip()),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_what_is_rendered_for_dds_is_read_back(pairs: list[tuple[str, str]]) -> None:
    name = distinguished_names.parse(",".join(f"{kind}={value}" for kind, value in pairs))
    try:
        text = subject_names.render(name)
    except KeymintError as error:
        assert re.search("parts between|nothing stands between", str(error))  # noqa: PT017 - what these names can meet
        return
    assert text == ",".join(f"{kind}={value}" for kind, value in reversed(pairs))
    assert subject_names.parse_rendered(text) == name


@given(st.from_regex(subject_names._USUAL.pattern, fullmatch=True), st.sampled_from(list(VARIATIONS.values())))
def test_every_vendor_finds_the_grant_of_a_usual_name(name: str, variation: Variation) -> None:
    """So a member of a kind with such a name is not asked about by each model."""
    if subject_names.is_usual(name):  # the pattern means ASCII
        loaded = package(name=name)
        text, semantics = subject_names.subject_name_of(loaded.grant), variation.semantics
        assert semantics.selects(semantics.reads_text(text), text)
        assert semantics.reads_text(text) == text
        assert kind_members.PLAIN_TEXT.fullmatch(text)


@pytest.mark.parametrize(
    "text",
    [
        "CN=/robot",
        "OU=x1,CN=/robot/camera",
        r"C=US,ST=CA,L=San Jose,O=Acme\, Inc,CN=ca,emailAddress=a@b.c",
        r"O=\#1 a\+b #2,CN=a=b",
        "street=s,postalCode=1,DC=a,UID=u,serialNumber=12,SN=s,GN=g,title=t,dnQualifier=q,pseudonym=p,CN=/r",
    ],
)
def test_what_is_rendered_is_what_openssl_prints_for_the_vendors(tmp_path: Path, text: str) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed: apt-get install openssl")
    openssl = Openssl(tmp_path)
    key = keys.generate(P256)
    issued = certificates.issue(make_spec(text), key.public_key(), key, authority=True)
    openssl.put(ca=issued.pem)
    printed = openssl.run("x509", "-in", "ca", "-noout", "-subject", "-nameopt", "RFC2253").stdout.decode()
    assert subject_names.render(issued.certificate.subject) == printed.strip().removeprefix("subject=")
    assert subject_names.parse_rendered(subject_names.render(issued.certificate.subject)) == issued.certificate.subject


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (r"CN=a\;b", "';'"),
        (r"CN=a\\b", "DDS vendors compare"),
        ("CN=a|b", "'|'"),
        ("CN=é", "ASCII"),
        ("1.2.3.4=a", "1.2.3.4"),
        (r"CN=\ a", "spaces"),
        ("CN=a  b", "spaces"),
        ("CN=" + "/a" * 20, "21 parts"),
    ],
)
def test_names_that_vendors_compare_differently_are_refused(text: str, message: str) -> None:
    with pytest.raises(KeymintError) as caught:
        subject_names.render(distinguished_names.parse(text), HERE)
    assert message in str(caught.value)
    assert caught.value.diagnostics[0].code == "portability-subject-name"


def test_nineteen_path_segments_are_what_cyclone_takes() -> None:
    assert subject_names.render(distinguished_names.parse("CN=" + "/a" * 19)) == "CN=" + "/a" * 19


SUBJECTS = st.lists(st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,79}", fullmatch=True), min_size=1, max_size=30).map(
    lambda segments: "/" + "/".join(segments)
)


@given(SUBJECTS)
def test_the_common_name_and_the_unique_suffix_of_a_subject_fit_together(subject: str) -> None:
    common, unit = distinguished_names.common_name(subject), distinguished_names.unique_suffix(subject)
    assert subject_names.render(distinguished_names.parse(f"OU={unit},CN={common}")) == f"CN={common},OU={unit}"


PIECES = ["OU=", "CN=", "C=", "/", ",", "a", "a" * 30, "_.-", " ", "=", "+", "\\", "\n"]


@given(
    st.lists(st.sampled_from(PIECES), max_size=6).map("".join).map("/{}".format) | SUBJECTS,
    st.sampled_from(["OU=x1,", ""]),
)
def test_the_name_of_a_grant_is_that_of_the_parsed_name(common: str, unit: str) -> None:
    """The usual name is not parsed; the text is the same, and so is what is wrong."""

    def outcome(render: Callable[[], str]) -> object:
        try:
            return render()
        except KeymintError as error:
            return [each.message for each in error.diagnostics]

    text = f"{unit}CN={common}"
    expected = outcome(lambda: subject_names.render(distinguished_names.parse(text)))
    assert outcome(lambda: subject_names.subject_name_of(package(name=text).grant)) == expected


@pytest.mark.parametrize("name", ["OU=x1,CN=/", "OU=x1,CN=/a//b", "OU=x1,CN=/a/"])
def test_a_name_in_which_cyclone_dds_finds_an_empty_part_is_refused(name: str) -> None:
    with pytest.raises(KeymintError, match="nothing stands between two of its separators"):
        subject_names.subject_name_of(package(name=name).grant)


def test_the_root_enclave_has_its_common_name_last_in_a_grant() -> None:
    assert subject_names.subject_name_of(package(name="CN=/,OU=x1").grant) == "OU=x1,CN=/"
