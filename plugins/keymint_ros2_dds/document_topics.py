"""The topics that the documents of an installed enclave mention, whatever the policy says."""

from __future__ import annotations

from comarmor.errors import Origin
from keymint.api import Enclave
from keymint.errors import KeymintError
from keymint.pki import smime
from keymint_ros2_dds import decision
from keymint_ros2_dds.layout import PERMISSIONS_P7S
from keymint_ros2_dds.transports import enclave_files


def mentioned(enclave: Enclave) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return each expression of a topic with the expressions of partitions beside it, in the order of the document.

    Nothing is returned of a document that cannot be read: that is for the transports to say.
    """
    try:
        signed = enclave_files.content(enclave.folder, PERMISSIONS_P7S)
        document = decision.read(smime.signed_content(signed, Origin(PERMISSIONS_P7S)))
    except KeymintError:
        return ()
    found = (
        (topic, criteria.partitions or ())
        for grant in document.grants
        for rule in grant.rules
        for criteria in rule.criteria
        for topic in criteria.topics
    )
    return tuple(dict.fromkeys(found))
