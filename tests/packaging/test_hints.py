# SPDX-License-Identifier: Apache-2.0
"""Hints of Keymint to install a package: the package exists, and goes into Keymint's environment."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path

import pytest

from .conftest import CHECKOUT, Environment

TOLD = [
    *(
        path
        for folder in ("keymint", "comarmor", "plugins", "docs", "examples")
        for path in (CHECKOUT / folder).rglob("*")
    ),
    *CHECKOUT.glob("*.md"),
]


def test_no_text_suggests_installing_keymint_from_an_index() -> None:
    """An index may have another project with our distribution's name: install from a checkout or a wheel."""
    texts = {path: path.read_text() for path in TOLD if path.suffix in {".py", ".md", ".xml", ".j2"}}
    assert any("pipx install" in text for text in texts.values())
    fetched = re.compile(r"install[^\n]{0,40}keymint-tools|keymint-tools\[")
    assert [str(path) for path, text in texts.items() if fetched.search(text)] == []


@pytest.mark.xdist_group("packaging")
def test_the_command_for_pictures_names_the_environment(installed: Environment, tmp_path: Path) -> None:
    policy = CHECKOUT / "examples" / "talker_listener"
    assert uses(installed, policy) == ["uv", "pip", "install", "--python", f"{installed.python}", "resvg-py"]
    pip, pipx = installed.site_packages / "pip", installed.folder / "pipx_metadata.json"
    try:
        pip.mkdir()
        (pip / "__init__.py").touch()
        assert uses(installed, policy) == [f"{installed.python}", "-m", "pip", "install", "resvg-py"]
        pipx.touch()
        assert uses(installed, policy) == ["pipx", "inject", installed.folder.name, "resvg-py"]
    finally:
        pip.rename(tmp_path / "pip")
        pipx.unlink(missing_ok=True)


def uses(environment: Environment, policy: Path) -> list[str]:
    said = environment.keymint("graph", policy, "-o", "policy.png", code=1)
    (command,) = re.findall(r"install it with '(.*)', or write \.svg", said)
    assert os.access(environment.python, os.X_OK)
    return shlex.split(command)
