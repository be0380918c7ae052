"""Every `he3` command of the documentation and of the help's examples can be pasted into a shell as it stands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from he3.errors import He3Error
from services.console.cli.app import build
from services.console.cli.benchmarks import described
from services.runtime.options import parse_options

ROOT = Path(__file__).parents[4]
PAGES = [
    page
    for page in (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md")))
    if page.name != "CHANGELOG.md"  # it names what earlier versions had
]
APPLICATION = typer.main.get_command(build())

FENCE = re.compile(r"^```[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINE = re.compile(r"^ *(?:\w+\$ +)?(?:\.venv/bin/)?(he3 (?!ground:).*)$", re.MULTILINE)  # that one is a message
SHELL = re.compile(r"\s+(?:#|>|&|\|)(?:\s.*|$)")  # what the shell takes for itself
SERVICE = re.compile(r"python3? (?:-P )?-m services\.(link|field|rover|ground|recorder) +([^\n`]*)")
INLINE = re.compile(r"`(he3 [^`]+)`")


def in_blocks(text: str) -> list[str]:
    """The commands that stand on a line of their own: whole ones, to be typed as they are."""
    blocks = [*FENCE.findall(text), *re.findall(r"^ {4}he3 .*$", FENCE.sub("", text), re.MULTILINE)]
    return [SHELL.sub("", line) for block in blocks for line in LINE.findall(block)]


def in_sentences(text: str) -> list[str]:
    """The commands within sentences, of which some name no more than what the sentence is about."""
    return [" ".join(command.split()) for command in INLINE.findall(FENCE.sub("", text))]


def leaf(words: list[str]) -> tuple[Any, Any, list[str]]:
    """The command that the words name, its context, and the words after its name."""
    command, context, rest = APPLICATION, typer.Context(APPLICATION, info_name="he3"), words[1:]
    while isinstance(command, TyperGroup) and rest and not rest[0].startswith("-"):
        _, found, after = command.resolve_command(context, rest)
        assert found is not None
        command, context, rest = found, typer.Context(found, info_name=rest[0], parent=context), after
    return command, context, rest


def objection(text: str, *, whole: bool) -> str | None:
    """Why the command line does not take a command, or None. One that is not whole may lack arguments."""
    words = [word for word in shlex.split(text) if word != "..."]
    try:
        command, context, rest = leaf(words)
        known = {"-h", "--help"}.union(*([*flag.opts, *flag.secondary_opts] for flag in command.params))
        unknown = [word for word in rest if word.startswith("--") and word.split("=")[0] not in known]
        if unknown:
            return f"{text}: no flag {', '.join(unknown)}"
        if whole and not isinstance(command, TyperGroup) and "--help" not in rest:
            command.make_context(context.info_name, rest, parent=context.parent)
    except (TyperException, He3Error) as error:
        return f"{text}: {error}"
    return None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_a_page_is_taken_as_it_stands(page: Path) -> None:
    text = page.read_text()
    # NAME stands for a benchmark, or for a command that the reader adds; "he3 command ..." for any of its commands.
    named = [said for said in in_sentences(text) if not re.match(r"he3 (bench NAME|command NAME|command \.\.\.)", said)]
    objections = [objection(said, whole=True) for said in in_blocks(text)]
    objections += [objection(said, whole=False) for said in named]
    assert [said for said in objections if said] == []


def services_of(page: Path) -> list[tuple[str, str]]:
    """The services that a page starts by hand, with the flags that it gives them."""
    return [(name, SHELL.sub("", rest)) for name, rest in SERVICE.findall(page.read_text())]


@pytest.mark.parametrize("page", [page for page in PAGES if services_of(page)], ids=lambda page: page.name)
def test_every_service_that_a_page_starts_by_hand_takes_its_flags(page: Path) -> None:
    for name, rest in services_of(page):
        if rest and rest != "SCENARIO":
            assert parse_options(name, shlex.split(rest))


def test_the_pages_have_hundreds_of_commands_that_are_read() -> None:
    texts = [page.read_text() for page in PAGES]
    assert sum(len(in_blocks(text)) for text in texts) > 150
    assert sum(len(in_sentences(text)) for text in texts) > 150


@pytest.mark.parametrize(
    "mistake",
    [
        "he3 maps at 120 340",
        "he3 map at 120",
        "he3 map at 120 north",
        "he3 bench papers",
        "he3 run t1 --in-procces",
        "he3 status      a comment that no shell takes for one",
    ],
)
def test_a_command_with_a_mistake_is_found(mistake: str) -> None:
    assert in_blocks(f"```\n{mistake}      # what it is said to do\n```\n") == [mistake]
    assert objection(mistake, whole=True)


def helped(group: TyperGroup, words: tuple[str, ...] = ("he3",)) -> Iterator[tuple[str, Any]]:
    """Every command that the help shows, by its words."""
    for name, command in group.commands.items():
        if command.hidden:
            continue
        if isinstance(command, TyperGroup):
            yield from helped(command, (*words, name))
        else:
            yield " ".join((*words, name)), command


HELPED = dict(helped(APPLICATION))


@pytest.mark.parametrize("words", HELPED)
def test_every_example_of_the_help_is_taken_as_it_stands(words: str) -> None:
    examples = [SHELL.sub("", line) for line in LINE.findall(HELPED[words].epilog)]
    assert examples
    assert [said for example in examples if (said := objection(example, whole=True))] == []


@pytest.mark.parametrize("words", HELPED)
def test_the_examples_of_a_command_have_that_command(words: str) -> None:
    assert re.search(rf"^ *{words}(?:\s|$)", HELPED[words].epilog, re.MULTILINE)


@pytest.mark.parametrize("words", [*HELPED, *(f"he3 bench {name}" for name in described())])
def test_every_command_and_every_benchmark_is_on_a_page(words: str) -> None:
    pages = [" ".join(page.read_text().split()) for page in PAGES]
    assert any(re.search(rf"\b{words}(?![\w-])", page) for page in pages)
