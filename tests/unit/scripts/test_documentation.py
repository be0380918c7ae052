"""Every file, module, link and section that the documentation names exists."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS = ("he3", "schemas", "services", "benchmarks", "deploy", "tests", "scripts", "examples", "docs")
PATH = re.compile(rf"`((?!he3/MISSION)(?:{'|'.join(FOLDERS)})/[\w./-]*)`")  # he3/MISSION/... is a key
TEST = re.compile(r"\btests/[\w/]+\.py\b")
MODULE = re.compile(r"`((?:he3|schemas|services|benchmarks)(?:\.\w+)+)`")
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")
SECTION = re.compile(r"\]\(([^)#\s]*)#([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def exists(module: str) -> bool:
    """Whether it is a module, or a name in one."""
    package, _, name = module.rpartition(".")
    try:
        if importlib.util.find_spec(module) is not None:
            return True
    except ModuleNotFoundError:
        pass
    try:
        return hasattr(importlib.import_module(package), name)
    except ModuleNotFoundError:
        return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_and_module_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text()
    paths = [
        path for path in PATH.findall(text) + TEST.findall(text) if "NAME" not in path
    ]  # a name that the reader chooses
    missing = [path for path in paths if not (ROOT / path).exists()]
    missing += [module for module in MODULE.findall(text) if not exists(module)]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_within_the_project_leads_to_a_file(page: Path) -> None:
    targets = [target for target in LINK.findall(page.read_text()) if "://" not in target]
    assert not [target for target in targets if not (page.parent / target).exists()]


def sections(page: Path) -> set[str]:
    """The names by which GitHub links to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\s-]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_to_a_section_leads_to_a_heading(page: Path) -> None:
    links = [(name, section) for name, section in SECTION.findall(page.read_text()) if "://" not in name]
    targets = [(page.parent / name if name else page, section) for name, section in links]
    assert [f"{target.name}#{section}" for target, section in targets if section not in sections(target)] == []


def test_a_link_to_a_section_that_is_not_there_would_be_found() -> None:
    assert "mission-time-is-integer-nanoseconds-and-the-link-keeps-it" in sections(ROOT / "docs" / "architecture.md")
    assert SECTION.findall("[a page](delay.md#no-such-section)") == [("delay.md", "no-such-section")]
    assert "no-such-section" not in sections(ROOT / "docs" / "delay.md")


def test_every_room_of_the_code_and_of_deploy_is_in_the_list_of_rooms() -> None:
    listed = (
        (ROOT / "CONTRIBUTING.md").read_text().partition("## The rooms")[2].partition("```\n")[2].partition("```")[0]
    )
    packages = [file.parent for top in ("he3", "schemas", "services") for file in (ROOT / top).rglob("__init__.py")]
    rooms = packages + [folder for folder in (ROOT / "deploy").iterdir() if folder.is_dir()]
    assert len(rooms) > 20
    assert sorted({room.name for room in rooms if not re.search(rf"\b{room.name}\b", listed)}) == []
