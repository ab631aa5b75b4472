# SPDX-License-Identifier: Apache-2.0
"""The register of issued certificates: which were issued, to whom, and which are revoked. Frozen data, and its file.

Modules: :mod:`~keymint.life.issued_certificates` (the data, and what follows from it) and :mod:`~keymint.life.register_database`
(the file, an SQLite database).
"""
