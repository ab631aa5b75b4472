# SPDX-License-Identifier: Apache-2.0
"""``keymint status``."""

from __future__ import annotations

import re
import shutil
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import pytest
from cryptography import x509
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from tests.conftest import NOW, snapshot
from tests.effort import calls_of
from tests.families import flat


def rows(outcome) -> dict[str, list[str]]:
    return {line.split()[0]: line.split()[1:] for line in outcome.out.splitlines()[1:]}


def test_every_stage(keymint, policy: Path, tmp_path: Path) -> None:
    ws = tmp_path / "ws"
    keymint("init", "ws", "--policy", policy)
    assert rows(keymint("status", cwd=ws))["talker"] == ["-", "create", "-", "-", "-"]
    keymint("create", "--all", cwd=ws)
    assert rows(keymint("status", cwd=ws))["talker"][:2] == ["source", "build"]
    keymint("build", cwd=ws)
    assert rows(keymint("status", cwd=ws))["talker"][:2] == ["built", "install"]
    keymint("install", cwd=ws)
    assert rows(keymint("status", cwd=ws))["talker"][:2] == ["installed", "-"]


def test_writes_nothing(keymint, provisioned: Path) -> None:
    before = snapshot(provisioned)
    keymint("status", cwd=provisioned)
    assert snapshot(provisioned) == before


def test_a_changed_policy_is_stale(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text(policy.read_text().replace("<permissions><ros_subscribe/>", "<permissions><ros_publish/>"))
    found = rows(keymint("status", cwd=provisioned))
    assert found["robot1/listener"][:2] == ["installed", "create"]
    assert found["talker"][:2] == ["installed", "-"]


def test_changed_defaults_are_stale(keymint, provisioned: Path) -> None:
    path = provisioned / "profile/package.defaults/permissions.xml"
    path.write_text(path.read_text().replace("<id>0</id>", "<id>1</id>"))
    assert rows(keymint("status", cwd=provisioned))["talker"][:2] == ["installed", "build"]


def test_a_damaged_enclave_is_stale(keymint, provisioned: Path) -> None:
    (provisioned / "install/enclaves/talker/cert.pem").write_text("")
    assert rows(keymint("status", cwd=provisioned))["talker"][:2] == ["installed", "install"]


def test_a_package_that_is_gone_is_orphaned(keymint, provisioned: Path) -> None:
    shutil.rmtree(provisioned / "src/talker")
    assert rows(keymint("status", cwd=provisioned))["talker"][0] == "orphaned"


def test_from_when_on_it_is_renewed(keymint, provisioned: Path) -> None:
    def shown(days: int) -> tuple[str, str | None, str | None]:
        env = {"SOURCE_DATE_EPOCH": str(NOW + days * 86_400)}
        line = next(line for line in keymint("status", cwd=provisioned, env=env).out.splitlines() if "talker" in line)
        result = keymint("status", "--json", cwd=provisioned, env=env).document["result"]
        row = next(row for row in result["packages"] if row["package"] == "talker")
        return line.split("  ")[-1].strip(), row["renew_after"], row["ends_with"]

    after = "2027-09-11T21:36:00+00:00"
    assert shown(0) == ("2027-09-11 (239 d)", after, None)
    assert shown(250) == ("2027-09-11 (due)", after, None)
    env = {"SOURCE_DATE_EPOCH": str(NOW + 3600 * 86_400)}
    assert keymint("renew", cwd=provisioned, env=env).code == 3
    assert shown(3600) == ("with identity_ca", None, "identity_ca")


def test_metrics_for_a_monitor(keymint, provisioned: Path) -> None:
    assert keymint("revoke", "talker", "--reason", "superseded", cwd=provisioned).code == 0
    text = keymint("status", "--format", "openmetrics", cwd=provisioned).out
    families = {family.name: family for family in text_string_to_metric_families(text)}
    assert {family.type for family in families.values()} == {"gauge"}
    assert {name: family.unit for name, family in families.items() if not family.unit} == {"keymint_enclave_stale": ""}

    def values(name: str) -> dict[str, float]:
        return {"".join(sample.labels.values()): sample.value for sample in families[name].samples}

    enclaves = {"/talker", "/robot1/listener"}
    end, last = _seconds(2028, 1, 14), _seconds(2037, 1, 11)
    assert values("keymint_certificate_expiry_timestamp_seconds") == dict.fromkeys(enclaves, end)
    assert values("keymint_permissions_expiry_timestamp_seconds") == dict.fromkeys(enclaves, end)
    assert values("keymint_enclave_stale") == dict.fromkeys(enclaves, 0)
    assert values("keymint_revocation_list_expiry_timestamp_seconds") == {"identity_ca": last}
    authorities = ("identity_ca", "permissions_ca")
    assert values("keymint_authority_expiry_timestamp_seconds") == dict.fromkeys(authorities, last)
    assert values("keymint_authority_renew_after_timestamp_seconds") == dict.fromkeys(authorities, last - 365 * 86_400)
    after = datetime(2027, 9, 11, 21, 36, tzinfo=UTC).timestamp()
    assert values("keymint_renew_after_timestamp_seconds") == dict.fromkeys(enclaves, after)
    assert text.endswith("# EOF\n")


def _seconds(year: int, month: int, day: int) -> float:
    return datetime(year, month, day, tzinfo=UTC).timestamp()


def test_expiry(keymint, provisioned: Path) -> None:
    outcome = keymint("status", cwd=provisioned, env={"SOURCE_DATE_EPOCH": "1900000000"})
    assert "expired" in outcome.out


@pytest.mark.parametrize("end", ["2030-01-01T01:00:00+02:00", "2199-01-01T00:00:00"])
def test_the_record_has_the_dates_of_the_files(keymint, provisioned: Path, end: str) -> None:
    """A certificate ends with its authority's at the latest; without a record the dates come from the files."""
    path = provisioned / "profile/package.defaults/identities.xml"
    path.write_text(re.sub("<not_after>.*</not_after>", f"<not_after>{end}</not_after>", path.read_text()))
    for verb in ("build", "install"):
        assert keymint(verb, cwd=provisioned).code == 0
    recorded = rows(keymint("status", cwd=provisioned))
    assert {row[1] for row in recorded.values()} == {"-"}
    (provisioned / ".keymint/state.json").unlink()
    read = rows(keymint("status", cwd=provisioned))
    assert {name: row[2:] for name, row in recorded.items()} == {name: row[2:] for name, row in read.items()}
    certificate_end = x509.load_pem_x509_certificate((provisioned / "install/enclaves/talker/cert.pem").read_bytes())
    assert recorded["talker"][2] == f"{certificate_end.not_valid_after_utc:%Y-%m-%d}"


def test_a_policy_with_a_defect_is_said(keymint, provisioned: Path, policy: Path) -> None:
    policy.write_text("<profiles>")
    outcome = keymint("status", cwd=provisioned)
    assert "policy.xml:1" in outcome.err
    assert "talker" in outcome.out


def test_cost_grows_with_the_number_of_packages(keymint, tmp_path: Path) -> None:
    """Each package used to search the whole source space again."""
    sizes, calls = (8, 16, 48), []
    for size in sizes:
        (tmp_path / "policy.xml").write_text(flat(size))
        workspace = tmp_path / f"ws{size}"
        assert keymint("provision", "policy.xml", "-w", workspace, "-q").code == 0
        keymint("status", "-w", workspace)
        found, number = calls_of(partial(keymint, "status", "-w", workspace))
        assert found.code == 0
        calls.append(number)
    first, second = ((calls[at + 1] - calls[at]) / (sizes[at + 1] - sizes[at]) for at in (0, 1))
    assert second < 1.2 * first


def test_the_dates_are_those_in_force(keymint, provisioned: Path) -> None:
    def dates() -> dict[str, tuple[str | None, str | None]]:
        rows = keymint("status", "--json", cwd=provisioned).document["result"]["packages"]
        return {each["package"]: (each["certificate_expires"], each["permissions_expire"]) for each in rows}

    before = dates()
    assert all(permissions == certificate for certificate, permissions in before.values())
    assert keymint("set", "valid-for", "90d", cwd=provisioned).code == 0
    assert dates() == before
    assert keymint("build", cwd=provisioned).code == 0
    assert dates() == before
    assert keymint("install", cwd=provisioned).code == 0
    assert all(permissions == certificate for certificate, permissions in dates().values())
    assert dates() != before
    assert keymint("revoke", "talker", "--reason", "key-compromise", cwd=provisioned).code == 0
    assert dates()["talker"] == (None, None)
