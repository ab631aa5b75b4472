# SPDX-License-Identifier: Apache-2.0
"""Read signed and unsigned DDS Security documents into data types that know their lines.

Open ``signed_permissions`` first; ``dialects`` says what vendors read differently.
"""
