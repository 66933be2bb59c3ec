"""Check names, first lines of docstrings and words of prose: `python scripts/lint_words.py`.

Prints file, line, finding and the better word for all files, or for those that are named as
arguments. Also finds pages with too many words. Exceptions with a reason are in
`scripts/allowed_words.toml`; an exception that matches nothing is a finding too.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
EXCEPTIONS = ROOT / "scripts" / "allowed_words.toml"
CODE = ("lunarsim", "envs", "scenarios", "scripts")
# Pages that quote other texts or old names: not checked.
QUOTING_PAGES = ("docs/about/licences.md", "docs/about/renamed.md")
# Generated pages may be longer than a reader reads at once.
LONG_PAGES = ("docs/reference/", *QUOTING_PAGES)
MAX_PAGE_WORDS = 2000

# Word (a regular expression) and what to write.
WORDS = {
    r"told|tells?|telling": "given, reports, estimates, distinguishes",
    r"says?|said|saying": "reports, states",
    r"pictures?": "image",
    r"eyes?": "sensor",
    r"a look|looks|each look|looked": "observation, view; observes",
    r"errs?|erring": "has an error of",
    r"judged?|judges|judging": "evaluated, classified",
    r"verdicts?": "landing outcome",
    r"aside": "lateral",
    r"besides|withal": "also",
    r"anew": "again",
    r"nought": "zero",
    r"grounds?": "terrain",
    r"so many|so often|so long|so far off": "the quantity by name",
    r"greatest|the most|the least": "maximum, minimum",
    r"least": "minimum",
    r"doubts?|doubted|doubtful": "uncertainty",
    r"hopeless|cautious|sure": "conservative, or the threshold by its name",
    r"stretch|stretches": "time scale, interval",
    r"strain|stead|outlook|gathering": "limit violation, substitute, site evaluation, accumulator",
    r"as a whole|the whole|wholly|whole": "complete, entire; atomic (file writes); integer",
    r"believes?|believed": "estimates",
    r"left out": "omitted",
    r"of (?:one's|its|their|your) own": "custom",
    r"by itself alone|nobody|somebody": "an active sentence with its subject",
}
NAMES = {
    "told", "tells", "tell", "said", "says", "errs", "judged", "verdict", "aside", "besides",
    "anew", "nought",
    "doubt", "doubted", "hopeless", "cautious", "sure", "strain", "stead", "outlook", "gathering",
    "picture", "pictures", "eye", "eyes", "greatest", "begun", "whole", "ground",
}  # fmt: skip
_WORD = re.compile("|".join(rf"(?P<w{i}>\b(?:{word})\b)" for i, word in enumerate(WORDS)), re.I)
_BETTER = list(WORDS.values())
_MAX_FIRST_LINE = 80


class Finding(NamedTuple):
    """One violation of the style rules: file, line, word, and text of the report."""

    file: str
    line: int
    word: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def main() -> None:
    """Print all findings that have no permitted exception; exit 1 if there are any."""
    exceptions = tomllib.loads(EXCEPTIONS.read_text(encoding="utf-8"))["exception"]
    phrases = [re.compile(one["phrase"], re.I) for one in exceptions if "phrase" in one]
    places = {(one["file"], one["word"].lower()) for one in exceptions if "file" in one}
    files = sys.argv[1:] or _files()
    found = [finding for file in files for finding in _in_file(file, phrases)]
    found += list(_repeated_classes(files))
    shown = [one for one in found if (one.file, one.word.lower()) not in places]
    places = {place for place in places if place[0] in files or not sys.argv[1:]}
    unused = places - {(one.file, one.word.lower()) for one in found}
    for one in shown:
        print(one)
    for file, word in sorted(unused):
        print(f"scripts/allowed_words.toml: nothing in {file} needs the exception {word!r}")
    if shown or unused:
        sys.exit(
            f"{len(shown) + len(unused)} findings; reasons for exceptions go into {EXCEPTIONS.name}"
        )


def _files() -> list[str]:
    """Return the paths of all files to check, relative to the repository."""
    found = [path for folder in CODE for path in sorted((ROOT / folder).rglob("*.py"))]
    found += [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    names = [path.relative_to(ROOT).as_posix() for path in found if path.exists()]
    return [name for name in names if name not in ("scripts/lint_words.py", *QUOTING_PAGES)]


def _in_file(file: str, phrases: list[re.Pattern[str]]) -> Iterator[Finding]:
    """Yield the findings of one file; `phrases` are permitted."""
    text = (ROOT / file).read_text(encoding="utf-8")
    if not file.endswith(".py"):
        # Code between fences is not prose; its lines are kept for the line numbers.
        prose = re.sub(r"^```.*?^```", lambda m: "\n" * m[0].count("\n"), text, flags=re.M | re.S)
        for line, words in enumerate(prose.splitlines(), 1):
            yield from _words(file, line, words, phrases)
        if len(text.split()) > MAX_PAGE_WORDS and not file.startswith(LONG_PAGES):
            excess = f"{len(text.split())} words; at most {MAX_PAGE_WORDS}. Split the page"
            yield Finding(file, 1, "length", excess)
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield from _words(file, token.start[0], token.string, phrases)
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            for line, prose in enumerate(node.value.splitlines()):
                yield from _words(file, node.lineno + line, prose, phrases)
        yield from _first_line(file, node)
        yield from _identifiers(file, node)


def _words(file: str, line: int, prose: str, phrases: list[re.Pattern[str]]) -> Iterator[Finding]:
    """Yield the banned words in a line of prose.

    Code in backticks and the permitted `phrases` are ignored.
    """
    prose = re.sub(r"`[^`]*`", "", prose)
    for phrase in phrases:
        prose = phrase.sub("", prose)
    for match in _WORD.finditer(prose):
        better = _BETTER[int(str(match.lastgroup)[1:])]
        yield Finding(file, line, match.group(), f"{match.group()!r} in prose; write: {better}")


def _first_line(file: str, node: ast.AST) -> Iterator[Finding]:
    """Yield a finding if the first line of a docstring is too long or incomplete."""
    if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
        return
    doc = ast.get_docstring(node)
    if not doc:
        return
    first = doc.splitlines()[0]
    line, name = getattr(node, "lineno", 1), getattr(node, "name", "module")
    if len(first) > _MAX_FIRST_LINE and not file.startswith("scenarios"):
        text = f"first line of the docstring of {name} has {len(first)} characters; at most 80"
        yield Finding(file, line, "first line", text)
    elif first[-1] not in ".:?":
        text = f"first line of the docstring of {name} is no complete sentence"
        yield Finding(file, line, "first line", text)


def _identifiers(file: str, node: ast.AST) -> Iterator[Finding]:
    """Yield a finding for each banned word in a name that a syntax node defines."""
    names: list[str] = []
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        names.append(node.name)
    elif isinstance(node, ast.arg):
        names.append(node.arg)
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        names.append(node.id)
    for name in names:
        parts = re.findall(r"[a-z]+", re.sub(r"([A-Z])", r"_\1", name).lower())
        for word in NAMES.intersection(parts):
            text = f"{word!r} in the name {name}; use the field's term"
            yield Finding(file, getattr(node, "lineno", 1), name, text)


def _repeated_classes(files: list[str]) -> Iterator[Finding]:
    """Yield a finding for each class name that is defined more than once."""
    places: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for file in files:
        if file.endswith(".py"):
            tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append((file, node.lineno))
    for name, at in places.items():
        for file, line in at[1:]:
            first = ":".join(map(str, at[0]))
            yield Finding(file, line, name, f"class {name} has the name of a class in {first}")


if __name__ == "__main__":
    main()
