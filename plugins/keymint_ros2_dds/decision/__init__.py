# SPDX-License-Identifier: Apache-2.0
"""The policy decision point: decide by the documents of an enclave, as the standard and each vendor do.

Open ``semantics`` first: it says in what implementations differ. ``evaluator`` decides.
"""
