# SPDX-License-Identifier: Apache-2.0
"""The proof that must hold before anything is signed, and after it was installed.

Start at :class:`keymint.stages.proof.prove.ProofStage`.
"""
