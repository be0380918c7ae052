"""The software bill of materials: every package of requirements.lock, with version, hashes, licence and dependencies.

    scripts/sbom sbom.cdx.json        CycloneDX 1.6; without a name to standard output
    scripts/sbom --licences           a table of packages and their licences

Names, versions and hashes are those of the lock. Licences and dependencies are what the installed packages say of
themselves. The same lock and environment give the same bytes.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
import uuid
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
_NAMESPACE = uuid.UUID("b0c5c1de-3b7e-5a51-9d0e-6a3f2a6f0e33")
_PINNED = re.compile(r"(?P<name>[A-Za-z0-9][A-Za-z0-9._-]*)==(?P<version>[^\s;\\]+)(?: *; *(?P<marker>[^\\]+))?")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")
_EXPRESSION = re.compile(r"[A-Za-z0-9.+-]+(?: (?:AND|OR|WITH) [A-Za-z0-9.+-]+)*")
UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Package:
    """A package of the lock."""

    name: str
    version: str
    hashes: tuple[str, ...]
    """SHA-256 of each of its files, any of which may be installed."""
    marker: str | None
    """On which systems it is needed; None: on all."""

    @property
    def purl(self) -> str:
        """Its package URL, which also names it in the document."""
        return f"pkg:pypi/{self.name}@{self.version}"

    @property
    def installed(self) -> Distribution | None:
        """What is installed here of that version; None if it is not."""
        try:
            found = distribution(self.name)
        except PackageNotFoundError:
            return None
        return found if found.version == self.version else None


def locked(text: str) -> list[Package]:
    """The packages of a lock, in its order."""
    found = []
    for block in re.split(r"\n(?=[A-Za-z0-9])", text):
        if (pinned := _PINNED.match(block)) is not None:
            marker = pinned["marker"]
            found.append(
                Package(_normal(pinned["name"]), pinned["version"], tuple(sorted(_HASH.findall(block))),
                        None if marker is None else marker.strip())
            )  # fmt: skip
    return found


def licence_of(package: Package) -> str:
    """The licence that the installed package states, as an SPDX expression where it has one."""
    found = package.installed
    if found is None:
        return UNKNOWN
    fields = found.metadata
    if expression := fields.get("License-Expression"):
        return str(expression)
    classified = [text.rpartition(" :: ")[2] for text in fields.get_all("Classifier") or () if "License ::" in text]
    stated = str(fields.get("License") or "").strip()
    if stated and "\n" not in stated and len(stated) <= 60:
        return stated
    return "; ".join(classified) or UNKNOWN


def document(packages: list[Package], name: str, version: str, licence: str) -> dict[str, Any]:
    """The bill of materials of that project, as CycloneDX 1.6 has it."""
    by_name = {package.name: package for package in packages}
    project = f"pkg:pypi/{name}@{version}"
    components = [_component(package) for package in packages]
    edges = [{"ref": package.purl, "dependsOn": _needs(package, by_name)} for package in packages]
    edges.insert(0, {"ref": project, "dependsOn": sorted(package.purl for package in packages)})
    body = json.dumps([components, edges], sort_keys=True)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(_NAMESPACE, project + body)}",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": project,
                "name": name,
                "version": version,
                "purl": project,
                "licenses": [{"expression": licence}],
            },
        },
        "components": components,
        "dependencies": edges,
    }


def _component(package: Package) -> dict[str, Any]:
    found = package.installed
    made: dict[str, Any] = {
        "type": "library",
        "bom-ref": package.purl,
        "name": package.name,
        "version": package.version,
        "purl": package.purl,
        "scope": "required" if package.marker is None else "optional",
        "properties": [{"name": "he3:sha256-of-a-file", "value": each} for each in package.hashes],
    }
    if found is not None and (summary := found.metadata.get("Summary")):
        made["description"] = str(summary)
    licence = licence_of(package)
    if licence != UNKNOWN:
        spdx = found is not None and found.metadata.get("License-Expression") and _EXPRESSION.fullmatch(licence)
        made["licenses"] = [{"expression": licence}] if spdx else [{"license": {"name": licence}}]
    return made


def _needs(package: Package, by_name: dict[str, Package]) -> list[str]:
    """References of what the package needs itself, as far as the lock has it."""
    found = package.installed
    required = [] if found is None else found.requires or []
    names = {_normal(re.split(r"[^A-Za-z0-9._-]", text, maxsplit=1)[0]) for text in required if "extra ==" not in text}
    return sorted(by_name[each].purl for each in names if each in by_name and each != package.name)


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def main(arguments: list[str] | None = None) -> int:
    """Exit code; 1 if a package of the lock that this system needs is not installed."""
    parser = argparse.ArgumentParser(prog="scripts/sbom", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", nargs="?", type=Path, help="file to write; default: standard output")
    parser.add_argument("--licences", action="store_true", help="print a table of packages and licences")
    given = parser.parse_args(arguments)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    packages = locked((ROOT / "requirements.lock").read_text(encoding="utf-8"))
    missing = [each.name for each in packages if each.marker is None and each.installed is None]
    if missing:
        sys.stderr.write(f"sbom: expected every package of requirements.lock (scripts/setup), missing {missing[0]}\n")
        return 1
    if given.licences:
        rows = [f"{each.name:<28} {each.version:<14} {licence_of(each)}" for each in packages]
        text = "\n".join(rows) + "\n"
    else:
        made = document(packages, project["name"], project["version"], project["license"])
        text = json.dumps(made, indent=2, ensure_ascii=False) + "\n"
    if given.file is None:
        sys.stdout.write(text)
    else:
        given.file.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
