# SPDX-License-Identifier: Apache-2.0
"""Schemas and templates are located in a wheel or a checkout."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from comarmor import data


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a package that is installed for the duration of a test."""
    folder = tmp_path / "package_of_a_test"
    folder.mkdir()
    (folder / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, folder.name, raising=False)
    return folder


@pytest.mark.parametrize(
    ("name", "kind", "file"),
    [
        ("comarmor", "schemas", "comarmor.xsd"),
        ("keymint_ros2_dds", "schemas", "**/*.xsd"),
        ("keymint_ros", "templates", "**/*.xml"),
    ],
)
def test_files_of_the_packages_exist(name: str, kind: str, file: str) -> None:
    assert any(data.locate(name, kind).glob(file))


def test_files_in_the_installed_package_come_first(package: Path) -> None:
    shipped = package / "_data" / "schemas"
    shipped.mkdir(parents=True)
    assert data.locate(package.name, "schemas") == shipped


def test_a_damaged_installation_is_reported_with_its_package(package: Path) -> None:
    with pytest.raises(FileNotFoundError, match=rf"lacks the templates of {package.name}; reinstall"):
        data.locate(package.name, "templates")
