# SPDX-License-Identifier: Apache-2.0
"""The build stage: what the documents hold, what is refused, and what is only said."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

from keymint.api import DomainRange, Validity
from tests.plugins.keymint_ros2_dds.builds import CHATTER, codes, refusal

from .packages import VALIDITY


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"domains": ()}, "domains"),
        ({"domains": (DomainRange(3, 1),)}, "domains"),
        ({"domains": (DomainRange(0, 231),)}, "portability-domain"),
        ({"domains": (DomainRange(1, 1),)}, "domain-uncovered"),
        ({"subject_name": "CN=/other"}, "subject-mismatch"),
        ({"validity": Validity(VALIDITY.not_after, VALIDITY.not_before)}, "validity-empty"),
        ({"validity": Validity(VALIDITY.not_before, datetime(2262, 1, 1, tzinfo=UTC))}, "portability-date"),
    ],
)
def test_what_does_not_fit_together_is_refused(fields, code):
    assert code in codes(refusal(CHATTER, **fields))


def test_the_documents_do_not_depend_on_the_hash_seed():
    program = (
        "import sys; sys.path[:0] = sys.argv[1:]\n"
        "from packages import package, rule\n"
        "from keymint.api import BuildOptions\n"
        "from keymint_ros2_dds import build_type\n"
        "both = 'ros_publish ros_subscribe'\n"
        "p = package(rule('ALLOW', 'ros_topic', both, '/a*', '*b', '/[xyz]'),"
        " rule('DENY', 'ros_topic', 'ros_publish', '/ab*'),"
        " rule('ALLOW', 'topic', 'publish', 'a*', 'b', partitions=['q', 'p', 'r']))\n"
        "print(build_type.build(p, BuildOptions()).documents)\n"
    )
    here = str(Path(__file__).parent)
    paths = [here, *sys.path]
    outputs = {
        subprocess.run(
            [sys.executable, "-c", program, *paths],
            env={"PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(outputs) == 1
    assert b"allow_rule" in outputs.pop()
