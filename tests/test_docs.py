# SPDX-License-Identifier: Apache-2.0
"""The documentation builds as a site without a warning, and says something of each verb and file of a workspace."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest

from keymint.cli import VERBS, cli

CHECKOUT = Path(__file__).resolve().parents[1]
SOURCES = (
    "docs", "examples", "benchmarks", "schemas", "keymint", "comarmor", "plugins", "templates", "CHANGELOG.md",
    "CONTRIBUTING.md", "README.md", "SECURITY.md", "Dockerfile", ".ci", "integrations", "action.yml",
)  # fmt: skip
pytestmark = pytest.mark.xdist_group("docs")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site of a copy of the checkout, as ``make docs`` does."""
    copy = tmp_path_factory.mktemp("docs")
    skipped = shutil.ignore_patterns("__pycache__", "generated", ".*_cache")
    for name in SOURCES:
        source = CHECKOUT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=skipped)
        else:
            shutil.copy2(source, copy / name)
    done = subprocess.run(
        [copy / ".ci" / "docs", copy / "site"],
        env=os.environ | {"BIN": str(Path(sys.executable).parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return copy / "site" / "docs"


def text_of(page: Path) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", page.read_text()))


@pytest.mark.parametrize("verb", VERBS)
def test_each_verb_has_a_page_with_its_options(verb: str, site: Path) -> None:
    command = cli.get_command(click.Context(cli), verb)
    assert command is not None
    page = text_of(site / "reference" / "generated" / "verbs" / f"{verb}.html")
    assert " ".join((command.help or "").split()[:5]) in page
    shown = [each for each in command.params if isinstance(each, click.Option) and (each.help or not each.hidden)]
    assert [name for each in shown for name in each.opts if name not in page] == []


def test_each_file_of_a_workspace_has_a_page(site: Path) -> None:
    """What has no page are the signed documents of DDS, a policy of SROS2, and parts of the other schemas."""
    folder = site / "reference" / "generated" / "files"
    listed = {
        match for page in folder.glob("*.html") for match in re.findall(r"keymint_\w+/\w+\.xsd", page.read_text())
    }
    schemas = {f"{path.parent.name}/{path.name}" for path in (CHECKOUT / "schemas").glob("keymint_ros*/*.xsd")}
    assert schemas - listed == {
        "keymint_ros/common.xsd", "keymint_ros2_dds/governance.xsd", "keymint_ros2_dds/permissions.xsd",
        "keymint_ros2_dds/source_types.xsd", "keymint_ros2_sros2/policy.xsd", "keymint_ros2_sros2/xml.xsd",
    }  # fmt: skip
    assert "issuer_name" in text_of(folder / "authorities.xml.html")


def test_each_code_has_its_place_with_cause_effect_and_remedy(site: Path) -> None:
    codes = (CHECKOUT / "tests" / "golden_codes.txt").read_text().split()
    page = (site / "reference" / "generated" / "codes.html").read_text()
    assert [code for code in codes if f'id="{code}"' not in page] == []
    assert page.count("<strong>remedy</strong>") == len(codes)


def test_the_pages_of_programs(site: Path) -> None:
    assert "class keymint.api.BuildType" in text_of(site / "reference" / "plugins.html")
    assert "class keymint.client.Client" in text_of(site / "reference" / "client.html")
