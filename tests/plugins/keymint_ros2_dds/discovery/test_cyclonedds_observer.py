# SPDX-License-Identifier: Apache-2.0
"""Observing where Cyclone DDS is not installed; where it is: ``tests/real/test_discover.py``."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from keymint_ros2_dds.discovery import cyclonedds_observer, graph_source

from keymint.errors import KeymintError


@pytest.fixture(params=["libno-such-library.so.1", "libc.so.6"])
def elsewhere(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Look for a library that is not there, or that is another one."""
    cyclonedds_observer.library.cache_clear()
    monkeypatch.setattr(cyclonedds_observer, "LIBRARY", request.param)
    monkeypatch.setattr(cyclonedds_observer, "_OTHER_NAMES", ())
    yield
    cyclonedds_observer.library.cache_clear()


@pytest.mark.usefixtures("elsewhere")
def test_it_is_not_usable_and_says_how_to_install_it() -> None:
    usable = graph_source.usable()
    assert not usable.usable
    assert usable.reason
    assert usable.help == "apt-get install libddsc0debian"
    with pytest.raises(KeymintError, match="libddsc0debian"):
        graph_source.observe(0, lambda: False, {})


@pytest.mark.usefixtures("elsewhere")
def test_the_verb_says_so(keymint) -> None:
    outcome = keymint("discover", "--domain", "0")
    assert outcome.code == 1
    assert "apt-get install libddsc0debian" in outcome.err
    assert "Traceback" not in outcome.err
