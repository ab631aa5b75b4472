# SPDX-License-Identifier: Apache-2.0
"""Places, diagnostics and errors as text."""

from __future__ import annotations

import pytest

from comarmor.errors import ComArmorError, Diagnostic, ExitCode, Origin, Reason, Severity, citation, require_none


@pytest.mark.parametrize(
    "folder",
    [
        "templates/keymint_ros/",
        "/opt/v/lib/python3.12/site-packages/keymint_ros/_data/templates/",
        "../checkout/templates/keymint_ros/",
    ],
)
def test_a_place(folder: str) -> None:
    file = f"{folder}comarmor.d/iron/common/node.xml"
    assert citation(file, 3) == "common/node.xml:3 (library)"
    outer = Origin("policy.xml", 7)
    assert str(Origin(file, 0, (outer,))) == "common/node.xml (library), included from policy.xml:7"
    assert citation("comarmor.d/common/node.xml", 3) == "comarmor.d/common/node.xml:3"


def test_a_reason_with_and_without_places() -> None:
    reason = Reason(("the DENY rule", Origin("policy.xml", 3), " matches"))
    assert str(reason) == "the DENY rule at policy.xml:3 matches"
    assert reason.without_places() == "the DENY rule matches"


def test_an_error_of_several_diagnostics() -> None:
    first, second = (Diagnostic("c", Severity.ERROR, text, Origin("f", 1), "fix it") for text in ("one", "two"))
    error = ComArmorError.of([first, second], ExitCode.USAGE)
    assert str(error) == "f:1: one (fix it)"
    assert (error.diagnostics, error.exit_code) == ((first, second), ExitCode.USAGE)


def test_diagnostics_are_raised_if_there_are_any() -> None:
    found = [Diagnostic.error("c", text) for text in ("one", "two")]
    require_none([])
    with pytest.raises(ComArmorError) as caught:
        require_none(each for each in found)
    assert caught.value.diagnostics == tuple(found)
