"""Prose of the checkout by kind and place: docstrings, comments, strings, Markdown."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.support.documents import ROOT

FOLDERS = ("ancfdae", "docs", "tests", "validation")
# Sphinx makes docs/made, `validation` writes reports, the changelog is a diary, and the test quotes
# bad sentences.
UNREAD = ("docs/made", "docs/reports", "docs/changelog.md", "tests/tools/test_english.py")


# An entry of numpydoc that is a number or an array, with its description.
_NUMBERS = re.compile(r"^[*\w, ]+ : (?:float|array|sequence of float)\b.*(?:\n(?: .*|$))*", re.M)
# Quick beside `tokenize`, whose tokens it need not make: a "#" within a string begins no comment.
_STRINGS_AND_COMMENTS = re.compile(
    r'"""(?:\\.|[^\\])*?"""'
    r"|'''(?:\\.|[^\\])*?'''"
    r'|"(?:\\.|[^\\"\n])*"'
    r"|'(?:\\.|[^\\'\n])*'|(?P<comment>#[^\n]*)",
    re.DOTALL,
)


class Text(NamedTuple):
    """A piece of prose with its place.

    `kind` is docstring, comment, string, markdown, rule or repair (of InvalidInputError), returns
    (the docstring of a function that returns an array) or parameter (an entry of numpydoc that is a
    number or an array).
    """

    kind: str
    file: str
    line: int
    words: str


def files(root: Path, suffix: str) -> Iterator[Path]:
    """Yield the files of a checkout that are read."""
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob(f"*{suffix}")):
            if not path.relative_to(root).as_posix().startswith(UNREAD):
                yield path
    yield from sorted(root.glob(f"*{suffix}"))


def _spoken(node: ast.expr) -> str | None:
    """Return the words of a string; what an f-string inserts becomes {}."""
    match node:
        case ast.Constant(value=str(words)):
            return words
        case ast.JoinedStr(values=parts):
            return "".join(_spoken(part) or "{}" for part in parts)
    return None


def _said(kind: str, name: str, node: ast.expr) -> Iterator[Text]:
    words = _spoken(node)
    if words is not None:
        yield Text(kind, name, node.lineno, words)


def _assigned(node: ast.Assign) -> Iterator[tuple[str, ast.expr]]:
    """Yield each name that is assigned to, with its value."""
    for target in node.targets:
        names, values = [target], [node.value]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            names, values = target.elts, node.value.elts
        for each, value in zip(names, values, strict=False):
            if isinstance(each, ast.Name):
                yield each.id, value


def _called(node: ast.AST) -> str:
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name
    return ""


def _of_python(path: Path, name: str) -> Iterator[Text]:
    source = path.read_text()
    nodes = list(ast.walk(ast.parse(source)))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings, inner = set(), set()
    for node in nodes:
        if isinstance(node, documented) and ast.get_docstring(node) is not None:
            first = node.body[0]
            docstrings.add(id(first.value))
            words = ast.get_docstring(node)
            yield Text("docstring", name, first.lineno, words)
            returned = getattr(node, "returns", None)
            if isinstance(returned, ast.Name) and returned.id == "Array":
                yield Text("returns", name, first.lineno, words)
            for entry in _NUMBERS.finditer(words):
                yield Text("parameter", name, first.lineno, entry[0])
        if isinstance(node, ast.JoinedStr):
            inner.update(id(part) for part in ast.walk(node) if part is not node)
        if _called(node) == "InvalidInputError" and len(node.args) > 1:
            yield from _said("rule", name, node.args[1])
            if len(node.args) == 4:
                yield from _said("repair", name, node.args[3])
        if isinstance(node, ast.Assign):
            for variable, value in _assigned(node):
                if variable in ("rule", "repair"):
                    yield from _said(variable, name, value)
    for node in nodes:
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in docstrings | inner:
            words = _spoken(node)
            if words is not None and len(words.split()) > 3:
                yield Text("string", name, node.lineno, words)
    for comment, line in _comments(source):
        if len(comment.split()) > 3:
            yield Text("comment", name, line, comment)


def _comments(source: str) -> Iterator[tuple[str, int]]:
    """Yield the comments; lines that follow each other are one."""
    words, began, last = [], 0, -1
    for found in _STRINGS_AND_COMMENTS.finditer(source):
        if not found["comment"]:
            continue
        line = source.count("\n", 0, found.start()) + 1
        if line != last + 1 and words:
            yield " ".join(words), began
            words = []
        began = began if words else line
        words.append(found["comment"].lstrip("#: "))
        last = line
    if words:
        yield " ".join(words), began


def _of_c(path: Path, name: str) -> Iterator[Text]:
    source = path.read_text()
    for comment in re.finditer(r"/\*(.*?)\*/", source, re.S):
        words = " ".join(comment[1].replace("\n *", " ").split())
        yield Text("comment", name, source.count("\n", 0, comment.start()) + 1, words)


def _of_markdown(path: Path, name: str) -> Iterator[Text]:
    line = 1
    # The words of reports are templates of strings, with places for figures.
    kind = "string" if name.startswith("validation/") else "markdown"
    blank, source = lambda m: "\n" * m[0].count("\n"), path.read_text()
    source = re.sub(r"^```.*?^```", blank, source, flags=re.S | re.M)
    for paragraph in re.split(r"\n\s*\n", source):
        if paragraph.strip():
            yield Text(kind, name, line, paragraph.strip())
        line += paragraph.count("\n") + 2


def _of_rst(path: Path, name: str) -> Iterator[Text]:
    """Yield the paragraphs without directives and programs, as of Markdown."""
    line = 1
    for paragraph in re.split(r"\n\s*\n", path.read_text()):
        if not re.match(r"\s*(\.\. |>>> |:)", paragraph) and len(paragraph.split()) > 3:
            yield Text("markdown", name, line, paragraph.strip())
        line += paragraph.count("\n") + 2


_READERS = {
    ".py": _of_python,
    ".h": _of_c,
    ".cpp": _of_c,
    ".md": _of_markdown,
    ".rst": _of_rst,
}


def prose(root: Path = ROOT) -> list[Text]:
    """Return all prose of a checkout."""
    return [
        text
        for suffix, read in _READERS.items()
        for path in files(root, suffix)
        for text in read(path, path.relative_to(root).as_posix())
    ]
