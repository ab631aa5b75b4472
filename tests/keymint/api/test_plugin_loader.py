# SPDX-License-Identifier: Apache-2.0
"""Plugins are found by their entry points; an error names the plugin."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from comarmor.errors import Origin
from keymint.api import API_VERSION, BuildOptions, BuildResult, ExportedPolicy, Package, PolicyFormat
from keymint.api.plugin_loader import GROUPS, PluginInfo, Plugins, entries_of
from keymint.errors import KeymintError
from keymint.ir import SubjectRules
from tests.conftest import installed_plugins
from tests.keymint.plain_build_type import PlainBuildType

GROUP = "keymint.build_types"


class Plugin(PlainBuildType):
    TRANSPORT = DOCUMENT = "none"

    def __init__(self, version: Any) -> None:
        self.API = version

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        raise NotImplementedError


class PolicyPlugin(PolicyFormat):
    API = API_VERSION

    def exported(self, subjects: Sequence[SubjectRules], *, lossy: bool = False) -> ExportedPolicy:
        raise NotImplementedError


def distribution(folder: Path, name: str, plugins: dict[str, str], *, group: str = GROUP) -> list[PluginInfo]:
    """Write the metadata of an installed distribution, and return its entry points."""
    info = folder / f"{name}-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    lines = [f"[{group}]", *(f"{plugin} = {target}" for plugin, target in plugins.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))
    return list(entries_of(str(info)))


@pytest.fixture(autouse=True)
def module(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    made = ModuleType("plugins_of_this_test")
    vars(made).update(
        good=Plugin(API_VERSION),
        newer=Plugin(API_VERSION.split(".", maxsplit=1)[0] + ".99"),
        future=Plugin(f"{int(API_VERSION.split('.', maxsplit=1)[0]) + 1}.0"),
        silent=object(),
        number=Plugin(1.0),
        alien=SimpleNamespace(API=API_VERSION),
        exported=PolicyPlugin(),
    )
    monkeypatch.setitem(sys.modules, made.__name__, made)
    return made


def refused(plugins: Plugins, name: str, where: Origin | None = None) -> tuple[str, str]:
    with pytest.raises(KeymintError) as caught:
        plugins.build_type(name, where)
    assert len(str(caught.value).splitlines()) == 1
    return caught.value.diagnostics[0].code, str(caught.value)


def test_a_plugin_is_found_and_loaded_once(tmp_path: Path, module: ModuleType) -> None:
    plugins = Plugins(distribution(tmp_path, "dist", {"mine": f"{module.__name__}:good"}))
    assert plugins.build_type("mine") is module.good
    assert plugins.build_type("mine") is plugins.load(GROUP, "mine")
    [info] = plugins.infos
    assert (info.group, info.name, info.distribution, info.version) == (GROUP, "mine", "dist", "1.2")
    assert info.location == str(tmp_path)


def test_a_newer_minor_version_of_the_interface_is_fine(tmp_path: Path, module: ModuleType) -> None:
    plugins = Plugins(distribution(tmp_path, "dist", {"mine": f"{module.__name__}:newer"}))
    assert plugins.build_type("mine") is module.newer


@pytest.mark.parametrize("attribute", ["future", "silent", "number"])
def test_another_major_version_or_none_is_refused(tmp_path: Path, module: ModuleType, attribute: str) -> None:
    plugins = Plugins(distribution(tmp_path, "dist", {"mine": f"{module.__name__}:{attribute}"}))
    code, message = refused(plugins, "mine")
    assert code == "plugin-version"
    assert "'mine'" in message
    assert API_VERSION in message
    assert "dist" in message


def test_an_object_of_another_class_is_refused(tmp_path: Path, module: ModuleType) -> None:
    plugins = Plugins(distribution(tmp_path, "dist", {"mine": f"{module.__name__}:alien"}))
    code, message = refused(plugins, "mine")
    assert code == "plugin-version"
    assert "'mine' (plugins_of_this_test:alien) is no BuildType of keymint.api" in message


def test_an_unknown_name_is_refused_with_the_nearest_one(tmp_path: Path, module: ModuleType) -> None:
    plugins = Plugins(distribution(tmp_path, "dist", {"keymint_ros2_dds": f"{module.__name__}:good"}))
    code, message = refused(plugins, "keymint_ros_dds", Origin("src/a/keymint_package.xml", 7))
    assert code == "plugin-unknown"
    assert message.startswith("src/a/keymint_package.xml:7: no build type 'keymint_ros_dds' is installed")
    assert "did you mean 'keymint_ros2_dds'?" in message
    assert "keymint plugins" in refused(plugins, "something else")[1]


def test_a_name_is_looked_up_in_its_own_group_only(tmp_path: Path, module: ModuleType) -> None:
    target = f"{module.__name__}:exported"
    plugins = Plugins(distribution(tmp_path, "dist", {"mine": target}, group="keymint.policy_formats"))
    assert plugins.policy_format("mine") is module.exported
    assert refused(plugins, "mine")[0] == "plugin-unknown"


def test_a_name_that_two_distributions_bring_is_refused(tmp_path: Path, module: ModuleType) -> None:
    target = f"{module.__name__}:good"
    one = distribution(tmp_path / "1", "dist-one", {"mine": target, "fine": target})
    two = distribution(tmp_path / "2", "dist-two", {"mine": target})
    plugins = Plugins([*one, *two])
    code, message = refused(plugins, "mine")
    assert code == "plugin-doubled"
    assert "dist-one and dist-two" in message
    assert plugins.build_type("fine") is module.good
    assert [info.distribution for info in plugins.infos] == ["dist-one", "dist-one", "dist-two"]


def test_one_distribution_that_is_seen_twice_is_no_double(tmp_path: Path, module: ModuleType) -> None:
    target = f"{module.__name__}:good"
    one = distribution(tmp_path / "1", "dist", {"mine": target})
    again = distribution(tmp_path / "2", "dist", {"mine": target})
    assert Plugins([*one, *again]).build_type("mine") is module.good


@pytest.mark.parametrize("target", ["no_such_module_anywhere:x", "plugins_of_this_test:missing", "exits_on_import:x"])
def test_a_plugin_that_fails_to_load_is_named(tmp_path: Path, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "exits_on_import.py").write_text("raise RuntimeError('not on this machine')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins = Plugins(distribution(tmp_path, "dist", {"mine": target}))
    code, message = refused(plugins, "mine")
    assert code == "plugin-broken"
    assert f"'mine' ({target})" in message
    assert "reinstall dist" in message


def test_an_entry_point_without_a_distribution_is_loaded_too(module: ModuleType) -> None:
    plugins = Plugins([PluginInfo(GROUP, "mine", f"{module.__name__}:good")])
    assert plugins.build_type("mine") is module.good
    assert plugins.infos[0].distribution == ""


DAMAGED = {
    "missing": None,
    "empty": b"",
    "nameless": b"Metadata-Version: 2.1\nVersion: 1.2\n",
    "blank name": b"Metadata-Version: 2.1\nName:\nVersion:\n",
    "not UTF-8": b"Metadata-Version: 2.1\nName: d\xefst\nVersion: 1.2\n",
    "binary": bytes(range(256)),
    "no header": b"\n\nName: in the body\n",
}


def damage(info: Path, content: bytes | None) -> None:
    if content is None:
        info.unlink()
    else:
        info.write_bytes(content)


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_damaged_metadata_does_not_hide_a_plugin(tmp_path: Path, module: ModuleType, content: bytes | None) -> None:
    distribution(tmp_path, "dist", {"mine": f"{module.__name__}:good"})
    info = tmp_path / "dist-1.2.dist-info"
    damage(info / "METADATA", content)
    plugins = Plugins(entries_of(str(info)))
    assert plugins.build_type("mine") is module.good
    assert plugins.infos[0].name == "mine"
    assert isinstance(plugins.infos[0].distribution + plugins.infos[0].version, str)
    assert plugins.versions


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_an_installed_distribution_that_is_damaged_is_no_matter(
    tmp_path: Path, module: ModuleType, content: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python gives None, warns or raises where metadata lacks a name: in 3.11, 3.12 and 3.14."""
    distribution(tmp_path, "dist", {"mine": f"{module.__name__}:good"})
    damage(tmp_path / "dist-1.2.dist-info" / "METADATA", content)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert installed_plugins().build_type("mine") is module.good
    # The same folder twice on the path is one plugin, whether or not its distribution says a name.
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    assert installed_plugins().build_type("mine") is module.good


@pytest.mark.parametrize("content", [b"\xff\xfe", b"mine = x:y\n", b"[keymint.build_types]\nmine\n"])
def test_entry_points_that_cannot_be_read_hide_nobody_else(
    tmp_path: Path, module: ModuleType, content: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        distribution(tmp_path, name, {"of-" + name: f"{module.__name__}:good"})
    (tmp_path / "a-1.2.dist-info" / "entry_points.txt").write_bytes(content)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert installed_plugins().build_type("of-b") is module.good


def test_the_shipped_plugins_are_found_in_the_environment() -> None:
    plugins = installed_plugins()
    found = {(info.group, info.name) for info in plugins.infos if info.distribution == "keymint-tools"}
    if not found:
        pytest.skip("keymint-tools is not installed in this environment")
    groups = {group for group, _ in found}
    assert groups <= set(GROUPS)
    assert groups >= {f"keymint.{kind}_types" for kind in ("profile", "package", "policy", "build")}
    for group, name in found:
        assert plugins.load(group, name).API == API_VERSION
