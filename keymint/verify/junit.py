"""Outcomes as JUnit XML, the format that CI servers show test results from."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from xml.etree import ElementTree as ET  # only writes

from comarmor.text import counted
from keymint.output.junit import legal, rendered
from keymint.verify.mismatch import Comparison, Mismatch
from keymint.verify.words import in_words


def junit(outcomes: Sequence[Comparison], subjects: Sequence[str]) -> bytes:
    """Return a test suite for each transport, with a test case for each subject; a case lists all its findings."""
    root = ET.Element("testsuites", name="keymint verify")
    for outcome in outcomes:
        found: defaultdict[str, list[Mismatch]] = defaultdict(list)
        for finding in outcome.findings:
            found[finding.edge.subject].append(finding)
        suite = ET.SubElement(
            root,
            "testsuite",
            name=f"{outcome.transport} ({outcome.tier})",
            tests=str(len(subjects)),
            failures=str(len(outcome.wrong)),
            errors="0",
            skipped="0",
        )
        for subject in subjects:
            case = ET.SubElement(suite, "testcase", classname=f"keymint.{outcome.transport}", name=legal(subject))
            if count := outcome.wrong.get(subject, 0):
                lines = [in_words([outcome.transport], finding) for finding in found[subject]]
                message = f"{counted(count, 'edge')} decided otherwise than the policy says"
                failure = ET.SubElement(case, "failure", type="verify", message=message)
                failure.text = legal("\n".join(lines) or "not listed: there are too many findings")
    return rendered(root)
