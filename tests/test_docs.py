# SPDX-License-Identifier: Apache-2.0
"""The documentation builds as a site without a warning, and says something of each verb and file of a workspace."""

from __future__ import annotations

import inspect
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from comarmor.errors import Origin
from keymint import api, client
from keymint.cli import VERBS, cli
from keymint.robots.bundle import unpack
from tests.conftest import CHECKOUT, Outcome

TALKER = CHECKOUT / "examples" / "talker_listener" / "talker_listener.xml"
SOURCES = (
    "docs", "examples", "benchmarks", "schemas", "keymint", "comarmor", "plugins", "templates", "CHANGELOG.md",
    "CONTRIBUTING.md", "README.md", "SECURITY.md", "Dockerfile", ".ci", "integrations", "action.yml",
)  # fmt: skip
pytestmark = pytest.mark.xdist_group("docs")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site of a copy of the checkout, as ``make docs`` does, but in a plain theme.

    The theme of the site computes its sidebar anew for each page, which is two thirds of the time of a build; one page
    in it is a test of its own.
    """
    copy = tmp_path_factory.mktemp("docs")
    skipped = shutil.ignore_patterns("__pycache__", "generated", ".*_cache")
    for name in SOURCES:
        source = CHECKOUT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=skipped)
        else:
            shutil.copy2(source, copy / name)
    run(copy / ".ci" / "docs", copy / "site", "html", "-D", "html_theme=basic")
    return copy / "site" / "docs"


def run(*command: str | Path) -> None:
    environment = os.environ | {"BIN": str(Path(sys.executable).parent)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_theme_of_the_site_has_a_sidebar_with_the_pages_below(site: Path) -> None:
    built, source = site.parent, site.parent.parent
    sphinx = (Path(sys.executable).parent / "sphinx-build", "--quiet", "--fail-on-warning")
    run(*sphinx, "-c", source / "docs", source, built, source / "docs" / "index.md")
    _, _, sidebar = (site / "index.html").read_text().partition("sidebar-tree")
    assert "reference/generated/verbs/provision.html" in sidebar


@pytest.fixture(scope="module")
def generated() -> SimpleNamespace:
    """What makes the pages of the reference."""
    return SimpleNamespace(**runpy.run_path(str(CHECKOUT / "docs" / "generated.py")))


def files_below(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


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
    assert [each.opts for each in shown if not each.help] == []


def test_each_file_of_a_workspace_that_has_a_schema_has_a_page(site: Path) -> None:
    """What has no page are the signed documents of DDS, a policy of SROS2, and parts of the other schemas."""
    folder = site / "reference" / "generated" / "files"
    listed = {match for page in folder.glob("*.html") for match in re.findall(r"\w+/\w+\.xsd", page.read_text())}
    schemas = {f"{path.parent.name}/{path.name}" for path in (CHECKOUT / "schemas").glob("*/*.xsd")}
    assert schemas - listed == {
        "comarmor/xinclude.xsd", "keymint_ros/certificate_documents.xsd", "keymint_ros/certificates.xsd",
        "keymint_ros/common.xsd", "keymint_ros/manifest_documents.xsd", "keymint_ros/rights_documents.xsd",
        "keymint_ros2_dds/governance.xsd", "keymint_ros2_dds/governance_documents.xsd",
        "keymint_ros2_dds/permissions.xsd", "keymint_ros2_dds/source_types.xsd", "keymint_ros2_sros2/policy.xsd",
        "keymint_ros2_sros2/xml.xsd",
    }  # fmt: skip
    page = text_of(folder / "src-NAME-identities.xml.html")
    assert "hash_algorithm: optional, SHA256, SHA384, SHA512. Hash of the signature." in page
    assert "Default: SHA256." in page
    assert "&lt;identity/&gt;" in page  # of the example


def test_each_element_and_attribute_of_each_file_has_a_text(generated: SimpleNamespace) -> None:
    for each in generated.documents():
        rows = [*generated.Schema(CHECKOUT / "schemas" / f"{each['schema']}.xsd").rows()]
        assert rows
        assert [path for path, _, _, meaning in rows if not meaning.endswith(".")] == [], each["path"]


def test_an_element_without_a_text_is_found(generated: SimpleNamespace, tmp_path: Path) -> None:
    content = (CHECKOUT / "schemas" / "keymint_ros2_zenoh" / "source_zenoh.xsd").read_text()
    (tmp_path / "schema.xsd").write_text(content.replace("TCP port of the router.", ""))
    rows = generated.Schema(tmp_path / "schema.xsd").rows()
    assert [path for path, _, _, meaning in rows if meaning.startswith("TCP") or not meaning] == ["zenoh/router/port"]


PLACES = {"NAME": r"\w[\w./-]*", "AUTHORITY": r"[\w.]+", "PACKAGE": r"\w+", "VERB": r"\w+", "SHELL": r"\w+", "…": ".+"}


@pytest.fixture
def known_file(generated: SimpleNamespace) -> re.Pattern[str]:
    """What matches each path that the table of files has."""
    pattern = "|".join(re.escape(each["path"]) for folder in generated.folders() for each in folder["file"])
    for name, any_name in PLACES.items():
        pattern = pattern.replace(name, any_name)
    return re.compile(pattern)


def test_each_file_of_a_workspace_has_a_row(site: Path, known_file: re.Pattern[str]) -> None:
    found = files_below(site.parents[1] / "docs" / "reference" / "generated" / "example" / "robot_ws")
    assert {"install.next/zenoh/router.json5", "private/identity_ca.next.key.pem", ".keymint/state.json"} <= found
    page = text_of(site / "reference" / "generated" / "files" / "index.html")
    assert "packages.lock.d/PACKAGE/…" in page
    assert [each for each in found if not known_file.fullmatch(each.replace("install.next/", "install/"))] == []


def test_each_file_of_the_keystore_of_a_robot_has_a_row(
    keymint: Callable[..., Outcome], tmp_path: Path, known_file: re.Pattern[str]
) -> None:
    assert keymint("provision", TALKER, "-w", "ws").code == 0
    asked = keymint("request", "/talker", "--folder", "KEYSTORE", "--json").document["result"]
    waiting = files_below(tmp_path / "KEYSTORE")
    name_and_key = f"/talker={asked['fingerprint']}"
    assert keymint("sign", asked["file"], "--fingerprint", name_and_key, "-w", "ws").code == 0
    manifest = json.loads(unpack((tmp_path / "talker.bundle").read_bytes(), Origin("talker.bundle"))["manifest.json"])
    trusted = ("--authority-fingerprint", manifest["authority"])
    assert keymint("accept", "talker.bundle", "--folder", "KEYSTORE", *trusted).code == 0
    found = {f"KEYSTORE/{each}" for each in waiting | files_below(tmp_path / "KEYSTORE")}
    assert {"KEYSTORE/.keymint/requests/talker/key.pem", "KEYSTORE/enclaves/talker/bundle.json"} <= found
    found = {each.replace("KEYSTORE/enclaves", "install/enclaves") if "bundle" not in each else each for each in found}
    found |= {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert [each for each in found if not known_file.fullmatch(each)] == []


def test_each_code_has_its_place_with_cause_effect_and_remedy(site: Path) -> None:
    codes = (CHECKOUT / "tests" / "golden_codes.txt").read_text().split()
    page = (site / "reference" / "generated" / "codes.html").read_text()
    assert [code for code in codes if f'href="#{code}">' not in page] == []
    assert [code for code in codes if f'id="{code}"' not in page] == []
    assert page.count("<strong>remedy</strong>") == len(codes)


def test_each_class_and_method_for_plugins_is_in_its_page(site: Path) -> None:
    page = (site / "reference" / "plugins.html").read_text()
    named = {name: getattr(api, name) for name in dir(api) if name[0] != "_" and name != "TYPE_CHECKING"}
    known = {name: each for name, each in named.items() if not inspect.ismodule(each)}
    public = {name: each for name, each in known.items() if getattr(each, "__module__", "keymint") not in FOREIGN}
    methods = {
        f"{name}.{method}"
        for name, each in public.items()
        if inspect.isclass(each)
        for method, function in vars(each).items()
        if method[0] != "_" and inspect.isfunction(function)
    }
    assert {"BuildType", "BuildType.build", "Package"} <= {*public, *methods}
    shown = set(re.findall(r'id="keymint\.api\.(\w+)"', page))
    assert [each for each in methods if f'id="keymint.api.{each}"' not in page] == []
    assert shown == public.keys()
    text = text_of(site / "reference" / "plugins.html")
    assert [group for group in entry_point_groups() if group not in text] == []


FOREIGN = ("functools", "importlib", "typing", "__future__")
"""Modules whose names :mod:`keymint.api` uses, and which plugins do not need from there."""


def entry_point_groups() -> set[str]:
    """Return the groups of plugins that the distribution registers."""
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
    return {each for each in project["entry-points"] if each.startswith("keymint.")}


def test_each_name_of_the_client_is_in_its_page(site: Path) -> None:
    page = (site / "reference" / "client.html").read_text()
    methods = {f"Client.{each}" for each in vars(client.Client) if each[0] != "_"}
    assert "Client.provision" in methods
    assert [each for each in {*client.__all__, *methods} if f'id="keymint.client.{each}"' not in page] == []
