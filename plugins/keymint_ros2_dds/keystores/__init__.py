# SPDX-License-Identifier: Apache-2.0
"""Keystores that other tools made: what their files contain, what their documents grant, and which are kept.

Start at :mod:`~keymint_ros2_dds.keystores.keystore_contents`. What is right and wrong about them is judged in
:mod:`keymint_ros2_dds.examine`.
"""

from __future__ import annotations

from keymint.api import KeystoreReader, lazy


class DdsKeystores(KeystoreReader):
    """Keystores and permissions of SROS2, openssl, and the guides of vendors."""

    found = lazy("keymint_ros2_dds.examine.adopted_keystore:examine_keystore")
    not_kept = lazy("keymint_ros2_dds.keystores.foreign_documents:not_kept")
    granted = lazy("keymint_ros2_dds.keystores.grants_as_rules:granted_rules")
    compared = lazy("keymint_ros2_dds.proving.document_relation:compare_document")
    compare = lazy("keymint_ros2_dds.keystores.foreign_documents:compare")
