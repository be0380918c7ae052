"""The bill of materials has what CycloneDX requires, and exactly the packages that a mission runs with."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def sbom(*words: str) -> str:
    command = [sys.executable, str(ROOT / "scripts" / "sbom.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def bom() -> dict:
    return json.loads(sbom())


def test_it_has_the_fields_that_the_format_requires(bom: dict) -> None:
    """CycloneDX 1.6, JSON schema: bomFormat and specVersion; type and name of a component; ref of a dependency."""
    assert (bom["bomFormat"], bom["specVersion"], bom["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(r"urn:uuid:[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}", bom["serialNumber"])
    known = {"type", "bom-ref", "name", "version", "purl", "scope", "properties", "description", "licenses"}
    for component in (bom["metadata"]["component"], *bom["components"]):
        assert {"type", "bom-ref", "name", "version", "purl"} <= component.keys() <= known
        assert re.fullmatch(r"pkg:pypi/[a-z0-9-]+@\S+", component["purl"])
        for licence in component.get("licenses", ()):
            assert licence.keys() in ({"expression"}, {"license"})
    references = [component["bom-ref"] for component in (bom["metadata"]["component"], *bom["components"])]
    assert len(set(references)) == len(references)
    assert [each["ref"] for each in bom["dependencies"]] == references
    assert all(set(each["dependsOn"]) <= set(references) for each in bom["dependencies"])


def test_it_lists_the_lock_and_no_tool_of_development(bom: dict) -> None:
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    wanted = {re.split(r"[ ;\\]", line)[0] for line in lines if line and line[0].isalnum()}
    assert {f"{each['name']}=={each['version']}" for each in bom["components"]} == wanted
    assert not {"pytest", "mypy", "ruff"} & {each["name"] for each in bom["components"]}
    assert all(each["properties"] for each in bom["components"])


def test_what_a_package_needs_is_in_it(bom: dict) -> None:
    needs = {each["ref"].partition("@")[0]: each["dependsOn"] for each in bom["dependencies"]}
    assert any(each.startswith("pkg:pypi/anyio@") for each in needs["pkg:pypi/starlette"])


def test_every_package_that_is_needed_here_states_a_licence(bom: dict) -> None:
    table = sbom("--licences").splitlines()
    assert len(table) == len(bom["components"])
    required = {each["name"] for each in bom["components"] if each["scope"] == "required"}
    unknown = {line.split()[0] for line in table if line.endswith("unknown")} & required
    assert unknown == set()


def test_it_is_the_same_each_time(bom: dict, tmp_path: Path) -> None:
    sbom(str(tmp_path / "sbom.cdx.json"))
    assert json.loads((tmp_path / "sbom.cdx.json").read_text()) == bom
