# SPDX-License-Identifier: Apache-2.0
"""The only writer: an enclave is old or new, whenever a run is killed.

Start at :class:`keymint.store.store.Store`.
"""
