# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from types import SimpleNamespace

import pytest
from keymint_ros2_dds.discovery import DdsGraphs

from keymint.api.plugin_loader import PluginInfo, Plugins
from keymint.command_line.options import graph_source
from keymint.errors import ExitCode, KeymintError

ONE, OTHER = DdsGraphs(), DdsGraphs()


def plugins_with(*names: str) -> Plugins:
    """Return plugins with these graph sources."""
    group = "keymint.graph_sources"
    entries = [PluginInfo(group, name, f"{__name__}:{name.upper()}", "test", "1") for name in names]
    return Plugins(entries)


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let entry points load this module."""
    import sys

    monkeypatch.setitem(sys.modules, __name__, SimpleNamespace(ONE=ONE, OTHER=OTHER))


def test_the_only_installed_source_needs_no_name() -> None:
    assert graph_source(plugins_with("one"), None, "--source") is ONE
    assert graph_source(plugins_with("other"), None, "--source") is OTHER


def test_a_named_source_is_chosen() -> None:
    assert graph_source(plugins_with("one", "other"), "other", "--source") is OTHER


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "no graph source is installed"),
        (("other", "one"), "several graph sources are installed: one, other; choose one: --source-type NAME"),
    ],
)
def test_without_a_name_there_must_be_one(names: tuple[str, ...], message: str) -> None:
    with pytest.raises(KeymintError) as caught:
        graph_source(plugins_with(*names), None, "--source-type")
    (said,) = caught.value.diagnostics
    assert f"{said.message}; {said.help}".startswith(message)
    assert caught.value.exit_code is ExitCode.USAGE
