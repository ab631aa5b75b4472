# SPDX-License-Identifier: Apache-2.0
"""The settings of a profile, as options of ``keymint init``."""

from __future__ import annotations

from dataclasses import replace

import pytest
from keymint_ros import profile_type

from .workspaces import REQUEST, Workspace


@pytest.mark.parametrize("subject_format", ["unique", "sros2"])
def test_the_settings_of_a_new_profile_are_the_options_that_created_it(subject_format: str) -> None:
    request = replace(REQUEST, domain=7, subject_format=subject_format, distro="humble", layout="flat")
    assert profile_type.settings(Workspace.new(request).load_profile()) == {
        "distro": "humble",
        "layout": "flat",
        "domain": "7",
        "subject-format": subject_format,
        "valid-for": "P365D",
    }


def test_edited_defaults_are_reported_as_they_are() -> None:
    defaults = "profile/package.defaults/permissions.xml"
    ranges = "<id>0</id><id_range><min>3</min><max>5</max></id_range>"
    edited = Workspace.new().edit(defaults, "<id>0</id>", ranges)
    edited = edited.edit(defaults, "OU={unique},CN={common_name}", "CN={name}")
    settings = profile_type.settings(edited.load_profile())
    assert (settings["domain"], settings["subject-format"]) == ("0, 3-5", "CN={name}")
