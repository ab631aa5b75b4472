# SPDX-License-Identifier: Apache-2.0
"""Documents with names beyond printable ASCII: the claims are right about what the vendors permit, byte for byte."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import pytest
from keymint_ros2_dds.vendors.cyclone_access_control import CycloneAccessControl
from keymint_ros2_dds.vendors.participants import System, Vendor

from keymint.api import Proof
from keymint.errors import KeymintError
from tests.plugins.keymint_ros2_dds.proving.byte_names import (
    NAMES,
    NOESCAPE,
    Case,
    by_cyclone,
    by_libc,
    cases,
    permitted,
    wanted,
)

from .conftest import on_each_fastdds
from .handmade import Authorities, criteria, permissions_document, rule
from .probe_commands import close
from .test_strictness import WIDE, signed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from keymint_ros2_dds.vendors.participants import ProbeParticipant

EXAMPLES = (
    Case((), ("a",), ((True, ("a", "covért")),)),
    Case((), ("a",), ((True, ("a", "c\\x")),)),
    Case((), ("?",), ((True, ("?", "é")),)),
    Case(("[!a]",), ("*",), ((False, ("[!a]",)), (True, ("*",)))),
)
SUBJECT = "CN=/t"


def usual(seed: int) -> Iterator[Case]:
    """Yield cases that the models cover, and whose text a vendor reads unchanged."""
    for case in cases(seed):
        texts = [text for _, listed in case.document for text in listed]
        if not any("\n" in text or text != text.strip() for text in texts):
            yield case


def enclave(authorities: Authorities, folder: Path, case: Case) -> Path:
    """Write an enclave with the document of a case."""
    plain = permissions_document(SUBJECT, rule("allow", criteria("publish", ["x"])))
    made = authorities.enclave(folder, governance=WIDE, permissions=plain, name="/t")
    (made / "permissions.p7s").write_bytes(signed(authorities, case.content()))
    return made


def hold(case: Case, by: Callable[[str], int], model: str, answers: Callable[[str], bool], names: list[bytes]) -> None:
    """Compare a vendor's decisions with the matcher, and with the claims."""
    mask = permitted(case, by)
    for name in names:
        text = name.decode("utf-8", "surrogateescape")
        assert answers(text) == bool(mask >> NAMES.index(name) & 1), (case, name)
    try:
        claims = [claim for claim in case.claims() if claim.model == model]
    except KeymintError:
        return
    for claim in claims:
        if claim.proof is Proof.PROVEN:
            differing = mask ^ wanted(case, "C")
            assert not any(differing >> NAMES.index(name) & 1 for name in names), (case, claim)
        elif claim.counterexample is not None:
            found = claim.counterexample
            if _is_text(found.endpoint.name.encode("utf-8", "surrogateescape")):
                assert answers(found.endpoint.name) is found.document.allowed, (case, claim)


@pytest.mark.cyclonedds
def test_the_claims_are_right_about_cyclone_dds(
    cyclone_plugins: None, authorities: Authorities, tmp_path: Path
) -> None:
    names = list(islice(NAMES, 0, None, 7))
    for number, case in enumerate((*EXAMPLES, *islice(usual(3), 60))):
        with CycloneAccessControl(enclave(authorities, tmp_path / str(number), case)) as opened:
            assert opened.valid, opened.reason
            hold(case, by_cyclone, "cyclonedds-0.10", lambda text, o=opened: o.allows("publish", text), names)


@on_each_fastdds
def test_the_claims_are_right_about_fast_dds(vendor: Vendor, authorities: Authorities, tmp_path: Path) -> None:
    # The probe reads names in UTF-8, one per line.
    names = [name for name in islice(NAMES, 0, None, 11) if _is_text(name)]
    with System(vendor) as system:
        for number, case in enumerate((*EXAMPLES, *islice(usual(5), 8))):
            participant = system.open(enclave(authorities, tmp_path / str(number), case))

            def answers(text: str, asked: ProbeParticipant = participant) -> bool:
                return asked.allows("publish", text)

            hold(case, lambda each: by_libc(each, NOESCAPE, "C"), "fastdds-2.9", answers, names)
            close(participant)


def _is_text(name: bytes) -> bool:
    try:
        return not set(name.decode()) & set("\n\t")
    except UnicodeDecodeError:
        return False
