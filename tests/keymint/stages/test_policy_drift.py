# SPDX-License-Identifier: Apache-2.0
"""A policy that changed after its packages were created is reported."""

from __future__ import annotations

import shutil
from pathlib import Path


def test_nobody_is_told_to_create_what_is_as_the_policy_says(keymint, provisioned: Path, policy: Path) -> None:
    defaults = provisioned / "profile/package.defaults/permissions.xml"
    text = defaults.read_text()
    defaults.write_text(text.replace("<not_after>", "<!-- longer --><not_after>"))
    policy.write_text(f"{policy.read_text()}<!-- reviewed -->")
    copy = shutil.copytree(provisioned, provisioned.parent / "copy", symlinks=True)
    for workspace in (provisioned, copy):
        for words in (["build"], ["install"]):
            outcome = keymint(*words, cwd=workspace)
            assert (outcome.code, outcome.err) == (0, "")


def test_a_subject_that_the_policy_names_since_is_told(keymint, just_provisioned: Path, policy: Path) -> None:
    more = "<profile name='new'><attachment>/new</attachment></profile></profiles>"
    policy.write_text(policy.read_text().replace("</profiles>", more))
    outcome = keymint("build", cwd=just_provisioned)
    assert (
        "1 source package out of date with the policy, which changed: /new (run 'keymint create --all'" in outcome.err
    )
    policy.write_text("<profiles>")
    outcome = keymint("build", cwd=just_provisioned)
    assert "the policy changed since the packages were created, and cannot be read: " in outcome.err
    assert outcome.err.count("\n") == 1


def test_sources_and_policy_that_changed_are_said(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("/chatter", "/other"))
    for words in (["build"], ["install"], ["install", "--no-prove"]):
        outcome = keymint(*words, cwd=provisioned)
        message = "2 source packages out of date with the policy, which changed: /robot1/listener, /talker"
        assert f"{message} (run 'keymint create --all', or" in outcome.err
    keymint("create", "--all", cwd=provisioned)
    outcome = keymint("install", "--no-prove", cwd=provisioned)
    assert "build/robot1/listener: warning: is stale; signing the existing build [2 packages]" in outcome.err
    keymint("build", cwd=provisioned)
    outcome = keymint("install", cwd=provisioned)
    assert outcome.code == 0
    assert all("rights that were signed before allow" in line for line in outcome.err.splitlines())
