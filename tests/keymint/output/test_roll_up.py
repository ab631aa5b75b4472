# SPDX-License-Identifier: Apache-2.0
"""Messages and steps that are alike are one line with their number; all of them with ``-v`` and in ``--json``."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable

import pytest

from comarmor.errors import Diagnostic, Origin
from keymint.errors import ExitCode
from keymint.output.console import Console, Streams
from keymint.output.report import FEW, Report
from keymint.store.changes import Action, FolderChange, Step


def shown(report: Report, **settings) -> tuple[list[str], list[str]]:
    """Return the lines of results and of diagnostics."""
    out, err = io.StringIO(), io.StringIO()
    Console(Streams(out, err), **settings).show(report)
    return out.getvalue().splitlines(), err.getvalue().splitlines()


WRITTEN = (FolderChange("install", removed=("cert.pem",)),)


def report(diagnostics: Iterable[Diagnostic] = (), steps: Iterable[Step] = ()) -> Report:
    return Report("provision", steps=tuple(steps), diagnostics=tuple(diagnostics))


def expiring(number: int) -> list[Diagnostic]:
    """Return a warning for each of some robots: names, days and places differ."""
    return [
        Diagnostic.warning(
            "certificate-expires",
            f"the certificate of '/r{at}/arm' ends in {at} days",
            Origin(f"install/enclaves/r{at}/arm/cert.pem"),
            "'keymint renew' issues it again",
            f"/r{at}/arm",
        )
        for at in range(number)
    ]


def test_many_alike_are_one_line_with_their_number_and_an_example() -> None:
    _, lines = shown(report(expiring(1300)))
    (line,) = lines
    assert line == (
        "install/enclaves/r0/arm/cert.pem: warning: the certificate of '/r0/arm' ends in 0 days "
        "('keymint renew' issues it again) [certificate-expires] (1 of 1,300 alike; -v shows all)"
    )


def test_few_are_shown_one_by_one_and_so_are_all_with_v() -> None:
    assert len(shown(report(expiring(FEW)))[1]) == FEW
    assert len(shown(report(expiring(FEW + 1)))[1]) == 1
    assert len(shown(report(expiring(300)), verbosity=1)[1]) == 300


def test_of_errors_the_first_are_shown_since_each_must_be_mended() -> None:
    errors = [Diagnostic.error("key-invalid", each.message, each.where, each.help) for each in expiring(300)]
    _, lines = shown(report(errors))
    assert [line.partition(":")[0] for line in lines] == [f"install/enclaves/r{at}/arm/cert.pem" for at in range(FEW)]
    assert [line.partition("] ")[2] for line in lines] == [""] * (FEW - 1) + ["(1 of 291 alike; -v shows all)"]
    assert len(shown(report(errors[:FEW]))[1]) == FEW


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], ["2 messages not shown (leave out -q)"]),
        ([Diagnostic.note("c", "m")], ["3 messages not shown (leave out -q)"]),
        ([Diagnostic.error("c", "m")], ["error: m [c]"]),
    ],
)
def test_a_quiet_run_that_ends_with_3_says_why(more: list[Diagnostic], said: list[str]) -> None:
    found = Report("check", diagnostics=[*expiring(2), *more], exit_code=ExitCode.FINDINGS)
    assert shown(found, verbosity=-1) == ([], said)
    assert shown(Report("diff", exit_code=ExitCode.FINDINGS), verbosity=-1) == ([], [])
    assert shown(report(expiring(2)), verbosity=-1) == ([], [])


def test_what_differs_by_more_than_names_is_not_alike() -> None:
    differing = [Diagnostic.warning("c", f"the {'un' * at}known word is wrong") for at in range(30)]
    errors = [Diagnostic.error("certificate-expires", each.message, each.where, each.help) for each in expiring(5)]
    _, lines = shown(report([*expiring(20), *differing, *errors]))
    assert len(lines) == 1 + 30 + 5


@pytest.mark.parametrize(
    "message", ["{name} is due", "/{name} is due", "{name}: is '{name}' of 3 in 'a', 'b'", "a/b, {name} and /c: is due"]
)
def test_names_are_what_a_message_is_about(message: str) -> None:
    """Also those of subjects without a digit or a slash, and lists of different lengths."""
    names = [left + right for left in ("alpha", "beta", "gamma", "delta") for right in ("", "_arm", "base", "tool")]
    found = [Diagnostic.note("c", message.format(name=name), subject=f"/{name}") for name in names]
    out, err = io.StringIO(), io.StringIO()
    Console(Streams(out, err)).show(Report("lint", diagnostics=found, notes=True))
    assert err.getvalue().count("\n") == 1
    assert "(1 of 16 alike" in err.getvalue()


def provisioned(number: int, action: Action = Action.CREATED) -> list[Step]:
    return [
        Step("init", "", Action.CREATED, WRITTEN, "workspace profile"),
        *(Step(stage, f"r{at}/arm", action) for stage in ("create", "build", "install") for at in range(number)),
    ]


def test_steps_are_summed_up_by_stage_and_action() -> None:
    lines, _ = shown(report(steps=provisioned(1000)))
    assert lines == [
        "created   init        workspace profile",
        "created   create      1,000 packages, e.g. r0/arm",
        "created   build       1,000 packages, e.g. r0/arm",
        "created   install     1,000 packages, e.g. r0/arm",
        "3,001 created",
    ]
    assert len(shown(report(steps=provisioned(FEW)))[0]) == 2 + 3 * FEW
    assert len(shown(report(steps=provisioned(1000)), verbosity=1)[0]) == 3002


def test_steps_for_different_reasons_are_apart() -> None:
    steps = [
        Step("install", f"r{at}", Action.UPDATED, WRITTEN, "later dates" if at % 2 else "new key") for at in range(100)
    ]
    assert shown(report(steps=steps))[0] == [
        "updated   install     50 packages, e.g. r0  (new key)",
        "updated   install     50 packages, e.g. r1  (later dates)",
        "100 updated",
    ]


def test_json_has_all() -> None:
    lines, _ = shown(report(expiring(300), provisioned(100)), as_json=True)
    document = json.loads("\n".join(lines))
    assert (len(document["diagnostics"]), len(document["steps"])) == (300, 301)


def test_lines_that_say_what_was_done() -> None:
    texts = [*(f"renewed /r{at}/arm: as you asked" for at in range(40)), "nothing else is due"]
    for verbosity, expected in ((0, 2), (1, 41), (-1, 0)):
        out = io.StringIO()
        Console(Streams(out, out), verbosity=verbosity).messages(texts)
        assert len(out.getvalue().splitlines()) == expected
    out = io.StringIO()
    Console(Streams(out, out)).messages(texts)
    assert out.getvalue() == "renewed /r0/arm: as you asked (1 of 40 alike; -v shows all)\nnothing else is due\n"
