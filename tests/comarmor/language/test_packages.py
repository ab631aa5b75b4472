# SPDX-License-Identifier: Apache-2.0
"""What a package ships applies inside of the profile that includes it, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest

import comarmor
from comarmor.errors import ComArmorError, Diagnostic
from comarmor.xml.package_folders import InstalledPackages
from tests.effort import calls_of
from tests.ros_packages import HREF, PACKAGE, XI, fragment, including, ship, topic


class Loader:
    """Loads policies that include what one prefix ships."""

    def __init__(self, folder: Path) -> None:
        self.prefix, self.path = folder / "prefix", folder / "policy" / "p.xml"
        self.path.parent.mkdir()

    def load(self, policy: str, shipped: dict[str, str], **others: str) -> comarmor.Policy:
        ship(self.prefix, shipped)
        self.path.write_text(policy)
        for name, content in others.items():
            (self.path.parent / "sub").mkdir(exist_ok=True)
            (self.path.parent / f"sub/{name}.xml").write_text(content)
        packages = InstalledPackages({"AMENT_PREFIX_PATH": str(self.prefix)})
        library = self.path.parents[1] / "library"
        return comarmor.load(self.path, library=library, packages=packages)

    def refused(self, policy: str, shipped: dict[str, str], **others: str) -> Diagnostic:
        with pytest.raises(ComArmorError) as caught:
            self.load(policy, shipped, **others)
        (found,) = caught.value.diagnostics
        return found


@pytest.fixture
def loader(tmp_path: Path) -> Loader:
    return Loader(tmp_path)


def test_a_profile_for_all_is_one_for_the_subjects_of_its_includer(loader: Loader) -> None:
    policy = loader.load(including(HREF), {"controller.xml": fragment(topic("/cmd_vel"), subjects="/*")})
    (rule,) = policy.rules("/robot/controller")
    assert str(rule.origin) == f"{HREF}:3, included from {loader.path}:2"
    assert policy.rules("/other") == ()
    assert [(each.package, each.path, str(each.where)) for each in policy.shipped] == [
        (PACKAGE, "controller.xml", f"{loader.path}:2")
    ]


@pytest.mark.parametrize("content", [fragment(topic("/cmd_vel")), "<profiles/>", topic("/cmd_vel")])
def test_outside_of_a_profile_it_is_refused(loader: Loader, content: str) -> None:
    found = loader.refused(f'<profiles {XI}>\n<xi:include href="{HREF}"/></profiles>', {"controller.xml": content})
    assert (found.code, str(found.where)) == ("package-outside", f"{loader.path}:2")


def test_also_through_a_file_of_the_owner(loader: Loader) -> None:
    inner = f'<profiles {XI}><xi:include href="{HREF}"/></profiles>'
    outer = f'<profiles {XI}><xi:include href="sub/inner.xml"/></profiles>'
    shipped = {"controller.xml": fragment(topic("/cmd_vel"))}
    assert loader.refused(outer, shipped, inner=inner).code == "package-outside"
    assert loader.load(including("sub/inner.xml"), shipped, inner=inner).rules("/robot/controller")


TUNABLE = '<tunable name="WHO"><value>/*</value></tunable>'


def test_it_declares_no_tunable_of_its_includer(loader: Loader) -> None:
    """It could change which subjects a later nested profile of its includer is about."""
    declares = f"<profiles>{TUNABLE}</profiles>"
    found = loader.refused(including(HREF), {"controller.xml": declares})
    assert (found.code, found.where and found.where.file) == ("package-tunable", HREF)
    twice = f'<profiles {XI}><xi:include href="part.xml"/></profiles>'
    assert loader.refused(including(HREF), {"controller.xml": twice, "part.xml": declares}).code == "package-tunable"


def test_it_may_declare_its_own_and_use_those_of_its_includer(loader: Loader) -> None:
    own = TUNABLE.replace("WHO", "OWN").replace("/*", "/own")
    shipped = fragment(own, topic("@{OWN}"), topic("@{ROBOT}/x"))
    policy = including(HREF).replace("<profile ", '<tunable name="ROBOT"><value>/r</value></tunable><profile ', 1)
    rules = loader.load(policy, {"controller.xml": shipped}).rules("/robot/controller")
    assert [rule.expressions for rule in rules] == [("/own",), ("/r/x",)]
    assert loader.refused(including(HREF), {"controller.xml": shipped}).code == "tunable"


def test_it_includes_files_of_its_own_folder_only(loader: Loader, tmp_path: Path) -> None:
    parts = fragment('<xi:include href="parts/a.xml"/>')
    policy = loader.load(including(HREF), {"controller.xml": parts, "parts/a.xml": topic("/a")})
    assert [each.path for each in policy.shipped] == ["controller.xml", "parts/a.xml"]
    (tmp_path / "library").mkdir()
    (tmp_path / "library/own.xml").write_text(topic("/own"))
    ship(loader.prefix, {"other.xml": topic("/other")}, "other_package")
    for href, code in (
        ("own.xml", "include-missing"),  # the library of the workspace
        ("../../../other_package/keymint/comarmor.d/other.xml", "include-outside"),
        ("parts/%2e%2e/%2e%2e/x.xml", "include-outside"),
        ("/etc/passwd", "include-outside"),
        ("controller.xml", "include-loop"),
        (HREF, "include-loop"),
    ):
        assert (
            loader.refused(including(HREF), {"controller.xml": fragment(f'<xi:include href="{href}"/>')}).code == code
        )
    by_name = fragment('<xi:include href="package://other_package/other.xml"/>')
    shipped = loader.load(including(HREF), {"controller.xml": by_name}).shipped
    assert [each.package for each in shipped] == [PACKAGE, "other_package"]


def test_names_that_links_in_a_package_multiply_are_refused_quickly(loader: Loader) -> None:
    """Each of these names is another file in a copy of the package."""
    parts = {f"{i}.xml": including(f"a/{i + 1}.xml", f"b/{i + 1}.xml") for i in range(14)}
    folder = ship(loader.prefix, {**parts, "14.xml": topic("/x")})
    for link in "ab":
        (folder / link).symlink_to(".")
    found, calls = calls_of(lambda: loader.refused(including(f"package://{PACKAGE}/0.xml"), {}))
    assert (found.code, calls < 1_000_000) == ("xml-limit", True)
    assert "more than the 500 other names" in found.message
    assert len(loader.load(including(f"package://{PACKAGE}/8.xml"), {}).shipped) == 2**7 - 1


def test_a_file_that_is_both_the_owners_and_a_packages_keeps_both_roles(loader: Loader) -> None:
    """As where a package's sources are linked: the rules for packages must not depend on who includes it first."""
    declares = f"<profiles>{TUNABLE}</profiles>"
    ship(loader.prefix, {"controller.xml": declares})
    folder = loader.prefix / "share" / PACKAGE / "keymint/comarmor.d"
    (loader.path.parent / "sub").mkdir()
    (folder / "controller.xml").rename(loader.path.parent / "sub/own.xml")
    (folder / "controller.xml").symlink_to(loader.path.parent / "sub/own.xml")
    loader.path.write_text(
        f'<profiles {XI}><profile name="a"><attachment>/a</attachment><xi:include href="sub/own.xml"/></profile>'
        f'<profile name="b"><attachment>/b</attachment><xi:include href="{HREF}"/></profile></profiles>'
    )
    packages = InstalledPackages({"AMENT_PREFIX_PATH": str(loader.prefix)}, None)
    with pytest.raises(ComArmorError) as caught:
        comarmor.load(loader.path, packages=packages)
    assert [each.code for each in caught.value.diagnostics] == ["package-tunable"]


def test_an_error_in_it_names_it(loader: Loader) -> None:
    found = loader.refused(including(HREF), {"controller.xml": "<profiles>\n<oops/></profiles>"})
    assert (found.where and found.where.file, str(found.where).endswith(f"included from {loader.path}:2")) == (
        HREF,
        True,
    )
    assert loader.refused(including(HREF), {"controller.xml": "<!DOCTYPE x><profiles/>"}).code.startswith("xml")


def test_a_missing_file_says_where_it_was_looked_for(loader: Loader) -> None:
    found = loader.refused(including(f"package://{PACKAGE}/control.xml"), {"controller.xml": topic("/a")})
    folder = loader.prefix / "share" / PACKAGE / "keymint/comarmor.d"
    assert found.code == "include-missing"
    assert found.help == f"looked for '{folder}/control.xml'; did you mean 'controller.xml'?"


def test_without_a_list_of_packages_none_can_be_included(loader: Loader) -> None:
    loader.path.write_text(including(HREF))
    with pytest.raises(ComArmorError) as caught:
        comarmor.load(loader.path)
    assert caught.value.diagnostics[0].code == "package-unavailable"
