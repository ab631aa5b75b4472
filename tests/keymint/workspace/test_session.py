# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.api import Layout
from keymint.errors import KeymintError
from keymint.workspace.session import Session

DEEP, TOP = Layout("enclaves"), Layout("", ("enclaves",))


def session_with(layout: str, **build_types: Mapping[str, Layout]) -> Any:
    """Return what of a session its layouts depend on."""
    marker = Origin("profile/keymint_profile.xml")
    return SimpleNamespace(
        profile=SimpleNamespace(layout=layout),
        profile_marker=lambda: marker,
        build_types={name: SimpleNamespace(LAYOUTS=layouts) for name, layouts in build_types.items()},
        workspace=SimpleNamespace(install=Path("/ws/install")),
    )


def layouts(session: Any) -> tuple[Layout, ...]:
    found: tuple[Layout, ...] = Session.layouts.fget(session)  # type: ignore[attr-defined]
    return found


def test_the_layout_is_that_of_each_build_type_that_has_it() -> None:
    session = session_with("top", one={"deep": DEEP}, two={"deep": DEEP, "top": TOP})
    assert layouts(session) == (TOP,)
    assert layouts(session_with("deep", one={"deep": DEEP}, two={"deep": DEEP, "top": TOP})) == (DEEP, DEEP)


def test_a_layout_that_no_build_type_has_is_an_error_of_the_profile() -> None:
    with pytest.raises(KeymintError) as caught:
        layouts(session_with("dep", one={"deep": DEEP}, two={"top": TOP}))
    (said,) = caught.value.diagnostics
    assert (said.code, said.where) == ("layout-unknown", Origin("profile/keymint_profile.xml"))
    assert "no build type of the workspace has a layout 'dep'" in said.message
    assert "'deep'" in said.help
