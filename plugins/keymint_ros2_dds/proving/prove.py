"""From an enclave that is installed to what is asked of it: its files are read again, and its signature is verified."""

from __future__ import annotations

from collections.abc import Sequence

from keymint.api import Claim, Obligation
from keymint.errors import KeymintError, Origin
from keymint_ros2_dds.document import PERMISSIONS_XML
from keymint_ros2_dds.install import CERTIFICATE, PERMISSIONS_P7S
from keymint_ros2_dds.proving import signed
from keymint_ros2_dds.proving.anchors import differences
from keymint_ros2_dds.proving.claims import Held
from keymint_ros2_dds.proving.content import prove_content
from keymint_ros2_dds.transports.files import subject_name


def prove(obligation: Obligation, *, models: Sequence[str] | None = None) -> tuple[Claim, ...]:
    """Return the claims about an enclave, by model, action and domains.

    Nothing is claimed of an enclave that does not rest on the workspace's authorities.

    Args:
        obligation: what is to be proven.
        models: names of the models; None: all.

    Raises:
        KeymintError: a file of the enclave is missing, cannot be read, or does not rest on the anchors, or a rule of
            the policy cannot be mapped.
    """
    folder = obligation.folder
    if found := differences(obligation.files, folder, obligation.anchors):
        raise KeymintError.of(found)
    authority = obligation.anchors.permissions.chain
    where = Origin(f"{folder}/{PERMISSIONS_P7S}")
    file = _file(obligation, PERMISSIONS_P7S)
    content = signed.content(file, authority, where)
    same = obligation.files.get(PERMISSIONS_XML) == content
    name, offset = (PERMISSIONS_XML, 0) if same else (PERMISSIONS_P7S, signed.lines_before(content, file))
    held = Held(
        subject_name(_file(obligation, CERTIFICATE), Origin(f"{folder}/{CERTIFICATE}")),
        obligation.rules,
        obligation.distro,
        obligation.domains,
        obligation.states,
        obligation.go_on,
    )
    return prove_content(content, (f"{folder}/{name}", offset), held, models=models)


def _file(obligation: Obligation, name: str) -> bytes:
    content = obligation.files.get(name)
    if content is None:
        raise KeymintError(
            "is missing", where=Origin(f"{obligation.folder}/{name}"), help="run 'keymint install'", code="file-missing"
        )
    return content
