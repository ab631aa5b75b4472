# SPDX-License-Identifier: Apache-2.0
"""Which names become packages and paths, and which are refused."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from keymint.errors import KeymintError
from keymint.names import (
    MAX_NAME,
    MAX_SEGMENT,
    ROOT,
    name_of,
    package_name,
    refuse_case_collisions,
    refuse_reserved,
    subject_list,
    subject_of,
)

SEGMENTS = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,30}", fullmatch=True)
NAMES = st.lists(SEGMENTS, min_size=1, max_size=6).map("/".join)


@given(NAMES)
def test_a_legal_name_is_itself_with_or_without_its_slash(name: str) -> None:
    assert package_name(name) == name
    assert package_name(f"/{name}") == name
    assert package_name(f"/{name}/") == name


@given(NAMES)
def test_subjects_and_packages_name_each_other(name: str) -> None:
    assert name_of(subject_of(name)) == name
    assert package_name(subject_of(name)) == name


def test_the_package_of_the_root_enclave_has_a_name_that_no_subject_has() -> None:
    assert (subject_of(ROOT), name_of("/"), package_name("/"), package_name(ROOT)) == ("/", ROOT, ROOT, ROOT)
    for text in (f"/{ROOT}", f"{ROOT}/a", f"a/{ROOT}", f"{ROOT}/"):
        with pytest.raises(KeymintError, match="is not a legal name"):
            package_name(text)


@given(st.text(max_size=60))
def test_whatever_is_accepted_is_a_relative_path_without_a_step_upward(text: str) -> None:
    refusal: KeymintError | None = None
    try:
        name = package_name(text)
    except KeymintError as error:
        refusal = error
    if refusal:
        assert refusal.diagnostics[0].code == "name-illegal"
        assert len(str(refusal).splitlines()) == 1
        return
    assert name.isascii()
    assert all(part and part not in {".", ".."} and "\0" not in part for part in name.split("/"))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "//",
        "//etc",
        "..",
        "/..",
        "../etc/passwd",
        "a/../b",
        "a//b",
        ".",
        "a/./b",
        "a\0b",
        "a\nb",
        "a\n",
        "a b",
        "1a",
        "a/1",
        "a-b",
        "~a",
        "a.xml",
        "*",
        "ä",
        "\u0430",  # a Cyrillic letter that looks like a Latin one
        "\udc80",
        "a" * (MAX_SEGMENT + 1),
        "/".join(["abc"] * (MAX_NAME // 4 + 1)),
    ],
)
def test_what_is_no_name_is_refused(text: str) -> None:
    with pytest.raises(KeymintError) as caught:
        package_name(text)
    assert caught.value.diagnostics[0].code == "name-illegal"


def test_the_longest_names_are_legal() -> None:
    assert package_name("a" * MAX_SEGMENT)
    longest = "/".join(["a" * 199] * 5)
    assert len(longest) == MAX_NAME - 1
    assert package_name("/" + longest) == longest


def test_a_message_does_not_repeat_an_endless_name() -> None:
    with pytest.raises(KeymintError) as caught:
        package_name("x" * 1_000_000)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("names", [["arm", "Arm"], ["robot/arm", "ROBOT/leg"], ["a/b/c", "a/B"], ["a", "A/b"]])
def test_names_that_differ_by_case_only_are_refused(names: list[str]) -> None:
    with pytest.raises(KeymintError) as caught:
        refuse_case_collisions(names)
    assert caught.value.diagnostics[0].code == "name-collision"


@given(st.lists(NAMES.map(str.lower), max_size=8))
def test_names_of_one_case_never_collide(names: list[str]) -> None:
    refuse_case_collisions(names)
    refuse_case_collisions(names + names)


@pytest.mark.parametrize("name", ["enclaves", "Enclaves/arm", "private/x"])
def test_a_name_of_a_folder_of_keystores_is_refused(name: str) -> None:
    with pytest.raises(KeymintError, match="is a folder of keystores") as caught:
        refuse_reserved(name, ("enclaves", "private"))
    assert caught.value.diagnostics[0].code == "name-reserved"


def test_other_names_are_not_reserved() -> None:
    refuse_reserved("robot/enclaves", ("enclaves",))
    refuse_reserved("enclaves", ())


def test_of_many_packages_a_line_lists_the_first() -> None:
    assert subject_list(()) == ""
    assert subject_list(["/robot/arm", "/talker"]) == "/robot/arm, /talker"
    names = [f"/{letter}" for letter in "abcdefghij"]
    assert subject_list(names[:8]) == "/a, /b, /c, /d, /e, /f, /g, /h"
    assert subject_list(names) == "/a, /b, /c, /d, /e, /f, /g, /h and 2 more"
