"""What the pages tell people to type exists: commands, their options, benchmarks, make's targets, pages linked."""

from __future__ import annotations

import importlib.util
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from benchmarks.__main__ import LEFT_OUT, PARTS, SHORT
from rm501_host.cli.main import cli
from rm501_sim_board.cli import main as sim_board
from tests.support.virtual_machine import REPOSITORY

PAGES = [
    REPOSITORY / "README.md",
    *sorted((REPOSITORY / "docs").glob("*.md")),
    *sorted((REPOSITORY / "docs/adr").glob("*.md")),
]
_FENCE = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`([^`\n]+)`")
_END = {"...", "|", "&&", ";"}


def _typed(text: str) -> Iterator[list[str]]:
    """The commands in fences and code spans of a page, as words."""
    fences = _FENCE.findall(text)
    lines = [line for fence in fences for line in fence.replace("\\\n", " ").splitlines()]
    for line in [*lines, *_SPAN.findall(_FENCE.sub("", text))]:
        for start in re.finditer(r"(?:^|(?<=[\s$]))(?:rm501-host|rm501-sim-board|python -m|make)(?= )", line):
            rest = re.split(r"\s#|\s{2,}", line[start.start() :])[0]
            words = shlex.split(rest) if rest.count("'") % 2 == 0 and rest.count('"') % 2 == 0 else rest.split()
            yield words


def _complaint(words: list[str]) -> str:
    """What is wrong with a command, empty when nothing is."""
    if words[0] == "make":
        targets = re.findall(r"^([a-z]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
        return "" if words[1] in targets else "no such target"
    if words[0] == "python":
        found = importlib.util.find_spec(words[2])
        if found is None or found.origin is None:
            return "no such module"
        source = Path(found.origin).read_text()
        return ", ".join(word for word in words[3:] if word.startswith("--") and f'"{word}"' not in source)
    command: click.Command = sim_board if words[0] == "rm501-sim-board" else cli
    context = click.Context(command)
    known = {option: param for param in command.params for option in param.opts}
    skip = False
    for word in words[1:]:
        if word in _END:
            break
        if skip:
            skip = False
        elif word.startswith("--"):
            option = known.get(word.split("=")[0])
            if option is None:
                return f"no option {word}"
            skip = isinstance(option, click.Option) and not option.is_flag and "=" not in word
        elif isinstance(command, click.Group):
            inner = command.get_command(context, word)
            if inner is None:
                return f"no command {word}"
            command = inner
            known = {option: param for param in command.params for option in param.opts}
        elif not any(isinstance(param, click.Argument) for param in command.params):
            return f"{command.name} takes no {word}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_is_to_be_typed_exists(page: Path) -> None:
    wrong = {" ".join(words): why for words in _typed(page.read_text()) if (why := _complaint(words))}
    assert wrong == {}


def test_commands_are_found_in_the_pages() -> None:
    """So that the test above looks at something."""
    typed = [words for page in PAGES for words in _typed(page.read_text())]
    assert len(typed) > 60
    assert {"run", "serve", "jog", "send", "commission"} <= {word for words in typed for word in words}


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("rm501-host fly", "no command fly"),
        ("rm501-host --speed max run x.ngc", "no option --speed"),
        ("rm501-host run x.ngc --fast", "no option --fast"),
        ("rm501-host status now", "status takes no now"),
        ("python -m benchmarks.nothing", "no such module"),
        ("python -m benchmarks.jogs --never", "--never"),
        ("make coffee", "no such target"),
    ],
)
def test_what_does_not_exist_is_found(line: str, why: str) -> None:
    assert _complaint(line.split()) == why


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_and_figures_that_are_linked_exist(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text())
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_every_page_is_listed() -> None:
    listed = (REPOSITORY / "docs" / "README.md").read_text() + (REPOSITORY / "docs" / "adr" / "README.md").read_text()
    assert [page.name for page in PAGES if page.name != "README.md" and f"({page.name})" not in listed] == []


def test_every_benchmark_runs_with_the_others_or_says_why_not() -> None:
    folder = REPOSITORY / "benchmarks"
    modules = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/__main__.py")}
    alone = {path.stem for path in folder.glob("*.py") if 'if __name__ == "__main__"' in path.read_text()} | {"avr"}
    assert modules - {"__init__", "__main__"} == {*SHORT, *LEFT_OUT, *PARTS}
    assert alone - {"__main__"} == {*SHORT, *LEFT_OUT}
    for part, whole in PARTS.items():
        assert re.search(rf"\b{part}\b", (folder / f"{whole}.py").read_text()), part


def test_every_benchmark_is_listed_with_what_it_prints() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", (REPOSITORY / "docs" / "benchmarks.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted({*SHORT, *LEFT_OUT})
