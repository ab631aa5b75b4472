# SPDX-License-Identifier: Apache-2.0
"""The rules about installed files, each in one place; :mod:`enclaves` is the door, for ``check`` and for proofs.

``configurations``: what the files of the router and of sessions must say. ``enclaves``: certificates and keys of an
enclave, what vouches for them, and the signature over the router's file.
"""
