# SPDX-License-Identifier: Apache-2.0
"""``issuance.xml``: generation, begin of validity and public key of a package, which Keymint writes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given, strategies as st
from keymint_ros import package_type
from keymint_ros2_dds import subject_names
from keymint_ros2_dds.subject_names import subject_name_of
from keymint_ros2_zenoh import identities

from keymint.api import Issuance, Package
from keymint.errors import KeymintError
from keymint.pki import distinguished_names, keys

from .workspaces import REQUEST, Workspace, diagnostic_of

DATE = datetime(2027, 3, 1, tzinfo=UTC)
PUBLIC_KEY = keys.public_to_pem(ec.derive_private_key(7, ec.SECP256R1()).public_key())
GENERATIONS = (0, 1, 2, 9, 10, 11, 999_999_999)
_FILE = "src/robot1/talker/issuance.xml"


def issued(workspace: Workspace, issuance: Issuance) -> Workspace:
    """Return the workspace after an authority decided something about the package."""
    return replace(workspace, package={**workspace.package, **package_type.with_issuance(issuance)})


def loaded(workspace: Workspace, generation: int) -> Package:
    return issued(workspace, Issuance(generation)).load()


@given(
    st.builds(
        Issuance,
        st.integers(0, 10**9 - 1),
        st.none() | st.datetimes(datetime(1990, 1, 1), datetime(9000, 1, 1), timezones=st.just(UTC)),  # noqa: DTZ001
        st.sampled_from([b"", PUBLIC_KEY]),
    )
)
def test_what_is_written_is_read_back(issuance: Issuance) -> None:
    whole = replace(issuance, renewed=issuance.renewed and issuance.renewed.replace(microsecond=0))
    files = package_type.with_issuance(issuance)
    assert [*files] == [package_type.ISSUANCE]
    assert package_type.issuance("src/robot1/talker", files) == whole


def test_generation_0_changes_no_byte_of_a_package(workspace: Workspace) -> None:
    plain = workspace.load()
    assert plain.issuance == Issuance()
    assert plain.identity.subject_name == f"OU={distinguished_names.unique_suffix('/robot1/talker')},CN=/robot1/talker"
    assert loaded(workspace, 0) == plain


def test_the_second_rdn_of_generation_0_is_what_it_was_before_there_were_generations() -> None:
    assert distinguished_names.unique_suffix("/talker") == "bf84d66f2a15bfa784e5419f752be36c"


def test_no_generation_contains_the_name_of_another(workspace: Workspace) -> None:
    names = {generation: loaded(workspace, generation).identity.subject_name for generation in GENERATIONS}
    grants = {generation: loaded(workspace, generation).grant.subject_name for generation in GENERATIONS}
    assert grants == names
    for one, name in names.items():
        assert len(distinguished_names.parse(name).rdns) == 2
        rdns = dict(distinguished_names.attributes(distinguished_names.parse(name)))
        assert rdns["CN"] == "/robot1/talker"
        assert len(rdns["OU"]) == 32
        assert not any(name in other or rdns["OU"] in other for two, other in names.items() if two != one)


def test_the_form_of_sros2_has_no_generation() -> None:
    workspace = Workspace.new(replace(REQUEST, subject_format="sros2"))
    assert loaded(workspace, 3).identity.subject_name == workspace.load().identity.subject_name == "CN=/robot1/talker"


@pytest.mark.parametrize("form", ["CN={subject}", "CN={name}", "CN={common_name}"])
def test_each_form_of_a_common_name_has_the_generation_for_zenoh(form: str) -> None:
    workspace = Workspace.new(replace(REQUEST, build_types=("keymint_ros2_zenoh",)))
    workspace = workspace.edit("profile/package.defaults/identities.xml", "OU={unique},CN={common_name}", form)
    names = {generation: identities.common_name(loaded(workspace, generation)) for generation in GENERATIONS}
    assert names[0] == ("robot1/talker" if form == "CN={name}" else "/robot1/talker")
    assert names[2] == f"{names[0]}.2"


@pytest.mark.parametrize("build_types", [("keymint_ros2_zenoh",), ("keymint_ros2_dds", "keymint_ros2_zenoh")])
def test_the_common_name_has_the_generation_for_zenoh(build_types: tuple[str, ...]) -> None:
    workspace = Workspace.new(replace(REQUEST, build_types=build_types))
    names = {generation: identities.common_name(loaded(workspace, generation)) for generation in GENERATIONS}
    assert names[0] == "/robot1/talker"
    assert names[10] == "/robot1/talker.10"
    assert len({*names.values()}) == len(GENERATIONS)
    tenth = loaded(workspace, 10)
    assert tenth.grant.subject_name == (tenth.identity.subject_name if "keymint_ros2_dds" in build_types else "")


@pytest.mark.parametrize("subject_format", ["OU={unique},CN={common_name}", "CN={common_name}"])
def test_no_vendor_takes_the_grant_of_another_generation(subject_format: str) -> None:
    """Cyclone DDS accepts a grant that has every part of the identity's name; Fast DDS compares the text."""
    both = ("keymint_ros2_dds", "keymint_ros2_zenoh")
    workspace = Workspace.new(replace(REQUEST, build_types=both))
    for path in ("identities", "permissions"):
        file = f"profile/package.defaults/{path}.xml"
        workspace = workspace.edit(file, "OU={unique},CN={common_name}", subject_format)
    names = {generation: subject_name_of(loaded(workspace, generation).grant) for generation in GENERATIONS}
    for comparison in (subject_names.parts_occur, subject_names.same_text, subject_names.same_name):
        accepted = {(old, new) for old in names for new in names if comparison(names[old], names[new])}
        assert accepted == {(generation, generation) for generation in GENERATIONS}


@pytest.mark.parametrize("subject", ["/a/" + "b" * 58, "/" + "b" * 63, "/" + "b" * 200, "/x" * 40])
def test_a_long_common_name_keeps_its_generation(subject: str) -> None:
    for generation in GENERATIONS:
        name = distinguished_names.common_name(subject, generation)
        assert len(name) <= distinguished_names.MAX_COMMON_NAME
        assert name.endswith(f".{generation}" if generation else subject[-1])
        assert name.startswith("/")


def test_a_renewed_package_begins_later_and_is_valid_as_long(workspace: Workspace) -> None:
    before, after = workspace.load(), issued(workspace, Issuance(renewed=DATE)).load()
    assert before.grant.validity
    assert after.grant.validity
    for old, new in (
        (before.identity.validity, after.identity.validity),
        (before.grant.validity, after.grant.validity),
    ):
        assert new.not_before == DATE
        assert new.not_after - new.not_before == old.not_after - old.not_before == timedelta(days=365)
        assert new.origin == old.origin
    assert after.identity.subject_name == before.identity.subject_name


def test_a_renewal_never_begins_before_the_sources_say(workspace: Workspace) -> None:
    before = workspace.load()
    after = issued(workspace, Issuance(renewed=datetime(2020, 1, 1, tzinfo=UTC))).load()
    assert (after.identity, after.grant) == (before.identity, before.grant)


def test_a_certificate_without_end_stays_without_end(workspace: Workspace) -> None:
    endless = workspace.edit(
        "profile/package.defaults/identities.xml", "2027-11-20T00:00:00</not_after>", "9999-12-31T23:59:59</not_after>"
    )
    after = issued(endless, Issuance(renewed=DATE)).load()
    assert after.identity.validity.not_after == datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)


def test_a_date_with_a_zone_is_read_in_utc() -> None:
    zone = timezone(timedelta(hours=5))
    content = package_type.with_issuance(Issuance(renewed=DATE))["issuance.xml"]
    shifted = content.replace(b"2027-03-01T00:00:00Z", DATE.astimezone(zone).isoformat().encode())
    assert shifted != content
    assert package_type.issuance("src/x", {"issuance.xml": shifted}).renewed == DATE


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("<generation>1<", "<generation>-1<", ""),
        ("<generation>1<", "<generation>01<", ""),
        ("<generation>1<", "<generation>1234567890<", ""),
        ("<generation>1</generation>", "", ""),
        ("<generation>", "<generation>1</generation><generation>", ""),
        ("<renewed>2027-03-01", "<renewed>2027-02-30", ""),
        ("<renewed>2027", "<renewed>0001", "date-invalid"),
        ("PUBLIC KEY-----\nM", "PUBLIC KEY-----\nX", "public-key-invalid"),
        ("BEGIN PUBLIC KEY", "BEGIN CERTIFICATE", "public-key-invalid"),
    ],
)
def test_a_defect_is_reported_with_its_line(workspace: Workspace, old: str, new: str, code: str) -> None:
    edited = issued(workspace, Issuance(1, DATE, PUBLIC_KEY)).edit("issuance.xml", old, new)
    found = diagnostic_of(edited.load, _FILE)
    assert not code or found.code == code


def test_a_private_key_in_the_place_of_the_public_one_is_refused_and_not_shown(workspace: Workspace) -> None:
    pem = keys.to_pem(ec.derive_private_key(7, ec.SECP256R1())).decode()
    edited = issued(workspace, Issuance(1, DATE, PUBLIC_KEY)).edit("issuance.xml", PUBLIC_KEY.decode().strip(), pem)
    found = diagnostic_of(edited.load, _FILE)
    assert found.code == "public-key-invalid"
    assert not any(line in str(found) + found.help for line in pem.splitlines()[1:-1])


def test_nothing_but_a_public_key_is_written() -> None:
    with pytest.raises(KeymintError, match="not an EC or RSA public key"):
        package_type.with_issuance(Issuance(public_key=b"</public_key><generation>0</generation>"))


def test_a_date_in_another_zone_is_written_in_utc() -> None:
    moment = DATE.astimezone(timezone(timedelta(hours=-7)))
    assert package_type.with_issuance(Issuance(renewed=moment)) == package_type.with_issuance(Issuance(renewed=DATE))


@pytest.mark.parametrize("generation", [-1, 10**9])
def test_a_generation_out_of_range_is_not_written(generation: int) -> None:
    with pytest.raises(KeymintError, match="is not a generation from 0 to"):
        package_type.with_issuance(Issuance(generation))


def test_its_defects_are_reported_with_those_of_the_other_documents(workspace: Workspace) -> None:
    broken = issued(workspace, Issuance(1)).edit("issuance.xml", "<generation>1", "<generation>x")
    broken = broken.edit("identities.xml", "<identity/>", "<identty/>")
    with pytest.raises(KeymintError) as error:
        broken.load()
    assert {each.where.file.rpartition("/")[2] for each in error.value.diagnostics if each.where} == {
        "issuance.xml",
        "identities.xml",
    }
