"""The topic expressions in the permissions document of an installed enclave."""

from __future__ import annotations

from comarmor.errors import Origin
from keymint.api import Enclave
from keymint.errors import KeymintError
from keymint.pki import smime
from keymint_ros2_dds import decision
from keymint_ros2_dds.enclave_layout import PERMISSIONS_P7S
from keymint_ros2_dds.transports import enclave_files


def document_topics(enclave: Enclave) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return each topic expression with its partition expressions, in the order of the document.

    The result is empty if the document cannot be read, which the transports report.
    """
    try:
        signed = enclave_files.content(enclave.folder, PERMISSIONS_P7S)
        document = decision.read(smime.signed_content(signed, Origin(PERMISSIONS_P7S)))
    except KeymintError:
        return ()
    topics = (
        (topic, criteria.partitions or ())
        for grant in document.grants
        for rule in grant.rules
        for criteria in rule.criteria
        for topic in criteria.topics
    )
    return tuple(dict.fromkeys(topics))
