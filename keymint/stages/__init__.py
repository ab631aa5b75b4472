# SPDX-License-Identifier: Apache-2.0
"""Plans: what each stage would do to the workspace, computed without touching it.

Start at :func:`keymint.stages.pipeline.conduct`, which knows the order of the stages. The proof that must hold before
anything is signed, and after it was installed, is :class:`keymint.stages.prove.ProofStage`.
"""
