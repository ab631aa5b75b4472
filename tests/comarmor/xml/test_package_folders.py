# SPDX-License-Identifier: Apache-2.0
"""Where packages ship profiles: the first prefix wins, as in ament_index, and nothing outside of a package is read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import comarmor
from comarmor.errors import ComArmorError, Diagnostic, Origin
from comarmor.xml.package_folders import CopiedPackages, InstalledPackages, PackageFolders
from tests.ros_packages import HREF, PACKAGE, fragment, including, register, ship, topic

WHERE = Origin("policy.xml", 3)
FILES = {"controller.xml": fragment(topic("/cmd_vel"))}


def packages(*prefixes: object, trusted: frozenset[str] | None = frozenset()) -> InstalledPackages:
    return InstalledPackages({"AMENT_PREFIX_PATH": ":".join(map(str, prefixes))}, trusted)


def names(policy: Path, found: PackageFolders, text: str = "") -> list[str]:
    """Return the topics that the controller may use."""
    policy.write_text(text or including(HREF))
    loaded = comarmor.load(policy, packages=found)
    return [name for rule in loaded.rules("/robot/controller") for name in rule.expressions]


def refused(found: PackageFolders, package: str = PACKAGE) -> Diagnostic:
    with pytest.raises(ComArmorError) as caught:
        found.folder(package, WHERE)
    (diagnostic,) = caught.value.diagnostics
    assert diagnostic.where == WHERE
    return diagnostic


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    return tmp_path / "policy.xml"


def test_the_first_prefix_wins_and_plugins_lists_both(tmp_path: Path, policy: Path) -> None:
    over = ship(tmp_path / "over", {"controller.xml": fragment(topic("/over"))})
    under = ship(tmp_path / "under", FILES)
    found = packages(tmp_path / "over", tmp_path / "under")
    assert names(policy, found) == ["/over"]
    assert names(policy, packages(tmp_path / "under", tmp_path / "over")) == ["/cmd_vel"]
    assert list(found.shipping()) == [
        (PACKAGE, over, ("controller.xml",), ""),
        (PACKAGE, under, ("controller.xml",), str(tmp_path / "over")),
    ]


def test_an_overlay_without_profiles_hides_those_of_its_underlay(tmp_path: Path) -> None:
    ship(tmp_path / "under", FILES)
    register(tmp_path / "over")
    found = refused(packages(tmp_path / "over", tmp_path / "under"))
    assert found.code == "package-without-profiles"
    assert f"'{tmp_path}/under' has some, but '{tmp_path}/over' comes first" in found.help


@pytest.mark.parametrize("text", [":{0}", "{0}:", "::{0}::", "{0}/none:{0}", "{0}:{0}", "{0}/"])
def test_odd_lists_of_prefixes(tmp_path: Path, policy: Path, text: str) -> None:
    ship(tmp_path / "prefix", FILES, registered=False)
    found = packages(text.format(tmp_path / "prefix"))
    assert names(policy, found) == ["/cmd_vel"]
    assert [hidden_by for *_, hidden_by in found.shipping()] == [""]


@pytest.mark.parametrize("prefix", ["install", ".", "./install", "~/install"])
def test_a_relative_prefix_before_the_package_is_refused(tmp_path: Path, policy: Path, prefix: str) -> None:
    ship(tmp_path / "prefix", FILES)
    assert refused(packages(prefix, tmp_path / "prefix")).code == "package-prefix"
    assert names(policy, packages(tmp_path / "prefix", prefix)) == ["/cmd_vel"]


def test_a_missing_package(tmp_path: Path) -> None:
    ship(tmp_path / "prefix", FILES)
    found = refused(packages(tmp_path / "prefix"), "nav2_bring_up")
    assert (found.code, found.help) == ("package-unknown", f"did you mean '{PACKAGE}'?")
    assert "source the setup file" in refused(packages(tmp_path / "prefix"), "another").help
    assert "AMENT_PREFIX_PATH is not set" in refused(InstalledPackages({})).help


def test_what_cannot_be_told_is_an_error_and_no_reason_to_take_the_next_prefix(tmp_path: Path) -> None:
    ship(tmp_path / "under", FILES)
    (tmp_path / "over/share/ament_index").mkdir(parents=True)
    loop = tmp_path / "over/share/ament_index/resource_index"
    loop.symlink_to(loop)
    found = refused(packages(tmp_path / "over", tmp_path / "under"))
    assert found.code == "unreadable"
    assert "symbolic links" in found.message


@pytest.mark.parametrize("function", ["scandir", "stat"])
def test_what_the_system_refuses(tmp_path: Path, policy: Path, monkeypatch: pytest.MonkeyPatch, function: str) -> None:
    """As for a folder without permissions, which root reads in spite of it."""
    folder = ship(tmp_path / "prefix", FILES)
    plain = getattr(os, function)

    def refusing(path: object, **options: object) -> object:
        if str(path).startswith(str(folder)):
            raise PermissionError(13, "Permission denied", str(path))
        return plain(path, **options)

    monkeypatch.setattr(os, function, refusing)
    found = packages(tmp_path / "prefix")
    if function == "scandir":
        assert [files for _, _, files, _ in found.shipping()] == [None]
        return
    with pytest.raises(ComArmorError) as caught:
        names(policy, found)
    assert caught.value.diagnostics[0].code == "unreadable"
    assert "Permission denied" in caught.value.diagnostics[0].message


def test_a_dangling_link_is_no_package(tmp_path: Path, policy: Path) -> None:
    """As after an overlay's sources were removed; ament_index skips it as well."""
    ship(tmp_path / "under", FILES)
    over = ship(tmp_path / "over", FILES, registered=False)
    over.parent.rename(tmp_path / "away")
    over.parent.symlink_to(tmp_path / "gone")
    marker = tmp_path / "over/share/ament_index/resource_index/packages" / PACKAGE
    marker.parent.mkdir(parents=True)
    marker.symlink_to(tmp_path / "gone")
    assert names(policy, packages(tmp_path / "over", tmp_path / "under")) == ["/cmd_vel"]


def test_a_folder_that_is_a_file(tmp_path: Path) -> None:
    share = tmp_path / "prefix/share" / PACKAGE / "keymint"
    share.mkdir(parents=True)
    (share / "comarmor.d").write_text("")
    assert refused(packages(tmp_path / "prefix")).code == "package-without-profiles"
    assert list(packages(tmp_path / "prefix").shipping()) == []


@pytest.mark.parametrize("level", ["file", "comarmor.d", "keymint", "share"])
def test_links_are_followed_out_of_a_package_only_if_they_are_trusted(tmp_path: Path, policy: Path, level: str) -> None:
    folder = ship(tmp_path / "prefix", {**FILES, "other.xml": fragment(topic("/other"))})
    linked = {"file": folder / "controller.xml", "comarmor.d": folder, "keymint": folder.parent}
    inside = linked.get(level, folder.parent.parent)
    source = tmp_path / "source"
    inside.rename(source)
    inside.symlink_to(source)
    with pytest.raises(ComArmorError) as caught:
        names(policy, packages(tmp_path / "prefix"))
    (found,) = caught.value.diagnostics
    assert found.code == "include-outside"
    assert "--trust-links" in found.help
    for trusted in (None, frozenset({PACKAGE})):
        assert names(policy, packages(tmp_path / "prefix", trusted=trusted)) == ["/cmd_vel"]
    with pytest.raises(ComArmorError):
        names(policy, packages(tmp_path / "prefix", trusted=frozenset({"another"})))


def test_a_linked_file_includes_what_is_beside_the_link(tmp_path: Path, policy: Path) -> None:
    folder = ship(tmp_path / "prefix", {"part.xml": topic("/part")})
    (tmp_path / "source").mkdir()
    (tmp_path / "source/a.xml").write_text(fragment('<xi:include href="part.xml"/>'))
    (folder / "controller.xml").symlink_to(tmp_path / "source/a.xml")
    assert names(policy, packages(tmp_path / "prefix", trusted=None)) == ["/part"]


def test_a_linked_prefix_is_no_link_out_of_a_package(tmp_path: Path, policy: Path) -> None:
    ship(tmp_path / "real", FILES)
    (tmp_path / "prefix").symlink_to(tmp_path / "real")
    assert names(policy, packages(tmp_path / "prefix")) == ["/cmd_vel"]


def test_two_dots_stay_refused_with_trusted_links(tmp_path: Path, policy: Path) -> None:
    files = {"controller.xml": fragment('<xi:include href="../../secret.xml"/>')}
    folder = ship(tmp_path / "prefix", files)
    (folder.parents[1] / "secret.xml").write_text(topic("/secret"))
    with pytest.raises(ComArmorError) as caught:
        names(policy, packages(tmp_path / "prefix", trusted=None))
    assert caught.value.diagnostics[0].code == "include-outside"


def test_what_tells_where_a_package_is(tmp_path: Path) -> None:
    ship(tmp_path / "b", FILES)
    ship(tmp_path / "c", FILES)
    found = packages(tmp_path / "a", tmp_path / "b", tmp_path / "c")
    looked_at = {str(path.relative_to(tmp_path)) for path in found.looked_at(PACKAGE)}
    assert {path.split("/")[0] for path in looked_at} == {"a", "b"}
    assert f"a/share/{PACKAGE}/keymint" in looked_at
    assert {str(path.relative_to(tmp_path))[0] for path in found.looked_at("another")} == {"a", "b", "c"}


def test_copies(tmp_path: Path, policy: Path) -> None:
    (tmp_path / "copies" / PACKAGE).mkdir(parents=True)
    text = including(HREF, f"package://{PACKAGE}/new.xml", "package://another/new.xml")
    (tmp_path / "copies" / PACKAGE / "controller.xml").write_text(fragment(topic("/accepted")))
    assert names(policy, CopiedPackages(tmp_path / "copies", absent_is_empty=True), text) == ["/accepted"]
    with pytest.raises(ComArmorError, match="does not exist"):
        names(policy, CopiedPackages(tmp_path / "copies"), text)


def test_the_environment_is_no_part_of_its_text() -> None:
    assert "secret" not in repr(InstalledPackages({"PASSWORD": "secret"}))
