"""Build type for DDS Security: rules to permissions and governance documents, signed, installed and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from comarmor.errors import Diagnostic
from keymint.api import (
    API_VERSION,
    Artifact,
    BuildOptions,
    BuildResult,
    Claim,
    Enclave,
    EnclaveCredentials,
    Inspection,
    Package,
    ProofTask,
    TrustAnchors,
    ValidityTerm,
)
from keymint.graph import Edge

__all__ = ["DdsSecurity", "build_type"]


class DdsSecurity:
    """Implements :class:`keymint.api.BuildType` for DDS Security 1.1 as Cyclone DDS and Fast DDS implement it."""

    API = API_VERSION

    def build(self, package: Package, options: BuildOptions) -> BuildResult:
        """See :func:`keymint_ros2_dds.build.build`."""
        from keymint_ros2_dds.build import build  # noqa: PLC0415 - listing plugins must not load XML and cryptography

        return build(package, options)

    def install(
        self,
        package: Package,
        documents: Mapping[str, bytes],
        credentials: EnclaveCredentials,
        layout: str,
        installed: Mapping[str, bytes],
    ) -> Mapping[str, Artifact]:
        """See :func:`keymint_ros2_dds.install.install`."""
        from keymint_ros2_dds.install import install  # noqa: PLC0415

        return install(package, documents, credentials, layout, installed)

    def shared(self, artifacts: Mapping[str, Mapping[str, Artifact]], layout: str) -> Mapping[str, Artifact]:
        """See :func:`keymint_ros2_dds.install.shared`."""
        from keymint_ros2_dds.install import shared  # noqa: PLC0415

        return shared(artifacts, layout)

    def check(self, inspection: Inspection) -> Sequence[Diagnostic]:
        """See :func:`keymint_ros2_dds.check.check`."""
        from keymint_ros2_dds.check import check  # noqa: PLC0415

        return check(inspection)

    def check_all(self, inspections: Sequence[Inspection]) -> Sequence[Diagnostic]:
        """See :func:`keymint_ros2_dds.check_keystore.check_all`."""
        from keymint_ros2_dds.check_keystore import check_all  # noqa: PLC0415

        return check_all(inspections)

    def endpoints(self, distro: str, edge: Edge) -> Sequence[Edge]:
        """See :func:`keymint_ros2_dds.lowering.endpoints.endpoints`."""
        from keymint_ros2_dds.lowering.endpoints import endpoints  # noqa: PLC0415

        return endpoints(distro, edge)

    def meanings(self, distro: str, endpoint: Edge) -> Sequence[Edge]:
        """See :func:`keymint_ros2_dds.lowering.endpoints.meanings`."""
        from keymint_ros2_dds.lowering.endpoints import meanings  # noqa: PLC0415

        return meanings(distro, endpoint)

    def assumptions(self) -> Mapping[str, Sequence[str]]:
        """See :data:`keymint_ros2_dds.proving.ASSUMPTIONS`."""
        from keymint_ros2_dds.proving import ASSUMPTIONS  # noqa: PLC0415

        return ASSUMPTIONS

    def differences(self, files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> Sequence[Diagnostic]:
        """See :func:`keymint_ros2_dds.proving.trust_anchors.differences`."""
        from keymint_ros2_dds.proving.trust_anchors import differences  # noqa: PLC0415

        return differences(files, folder, anchors)

    def terms(self, files: Mapping[str, bytes], folder: str, anchors: TrustAnchors) -> Sequence[ValidityTerm]:
        """See :func:`keymint_ros2_dds.proving.enclave_proof.terms`."""
        from keymint_ros2_dds.proving import terms  # noqa: PLC0415

        return terms(files, folder, anchors)

    def prove(self, task: ProofTask) -> Sequence[Claim]:
        """See :func:`keymint_ros2_dds.proving.prove`."""
        from keymint_ros2_dds.decision import OMG  # noqa: PLC0415
        from keymint_ros2_dds.proving import prove  # noqa: PLC0415

        return prove(task, models=(OMG.name,) if task.standard_only else None)

    def mentioned(self, enclave: Enclave) -> Sequence[tuple[str, Sequence[str]]]:
        """See :func:`keymint_ros2_dds.document_topics.mentioned`."""
        from keymint_ros2_dds.document_topics import mentioned  # noqa: PLC0415

        return mentioned(enclave)


build_type = DdsSecurity()
