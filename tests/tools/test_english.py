"""The prose of the checkout by the mechanical checks of its writing guide.

Checks with no hits allowed stay at zero. Every other check may only lose hits: lower its number in
`AT_MOST` when sentences are rewritten.
"""

import io
import re
import subprocess
import tarfile
from collections import Counter
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.support.documents import ROOT
from tests.support.prose import FOLDERS, Text, prose

KINDS = {"docstring", "comment", "string", "markdown", "rule", "repair", "returns", "parameter"}
SPOKEN = ("docstring", "comment", "string", "markdown")
VERBS = r"is|are|goes|takes?|chooses|computes|belongs?|cannot|has"
# Each check: its kinds of text and the pattern that marks a sentence to rewrite.
PATTERNS = {
    "opens with a pronoun": (
        ("docstring",),
        r"\A(That|Those|These|It|They|Its|Their|By which)\b",
    ),
    "opens with what": (("docstring",), r"\A(Return )?[Ww]hat\b"),
    "so many for a number": (SPOKEN, r"\bso (many|much|few|often)\b(?! that)"),
    "'what is' for a noun": (
        SPOKEN,
        r"(?i)\b(refuse|for|of|by|from|to) what (is|are|has|have|no|none|cannot|does|may|must)\b",
    ),
    "former, latter, dear": (SPOKEN, r"\b[Tt]he (former|latter)\b|\b[Dd]ear(er|est)?\b"),
    "but for": (SPOKEN, r"\bbut for\b"),
    "of both": (SPOKEN, r"\b(one|all|each) of both\b|\bof both\b(?= ?[.,;:)])"),
    "hedges": (
        SPOKEN,
        r"\b(hardly|surely|somewhat|rather|mostly|fairly|a little)\b(?! than)",
    ),
    "rule without a subject": (("rule",), rf"\A({VERBS})\b"),
    "as far as": (SPOKEN, r"\bas far as\b"),
    "is none": (SPOKEN, r"\b(is|are|was|were|be|has|have|does|as|what) none\b(?! of)"),
    "that of, those of": (SPOKEN, r"\b(that|those) of\b"),
    "fragment": (("docstring",), r"\. (Of|Without|With|Along) [^.,;:]{3,70}\."),
    "inversion": (
        SPOKEN,
        r"(?:\A|\. )(Of|From|To|Against) (?!here )[a-z][^.,;:]{3,50} "
        r"(is|are|was|has|have|keeps?|takes?|tells?) ",
    ),
    "tells": (SPOKEN, r"\b(tells?|told)\b"),
    "all of them": (SPOKEN, r"\b(all|none|some) of (it|them)\b"),
    "no such": (SPOKEN, r"\b[Nn]o such\b|\b([Rr]eturn|[Gg]ive) such\b|\b[Ss]uch (is|are)\b"),
    # A remedy that holds a call, an example or a name in backquotes says enough.
    "remedy of three words": (("repair",), r"\A(?!For example)[^\s(`]+( [^\s(`]+){0,2}\Z"),
    "the other": (SPOKEN, r"(?<!after )\bthe others?\b(?= ?[.,;:)])"),
    "instants": (SPOKEN, r"\b[Ii]nstants?\b"),
}
# The same for texts that lack words which they need.
LACKING = {
    "array without a shape": (("returns",), r"shape|\((?:\w|\.\.\.)[\w .+*]*, ?[^()]*\)"),
    "number without a unit": (
        ("parameter",),
        r";|\bm\b|\bs\b|\bN\b|\bPa\b|\bkg\b|\brad\b|\bunits?\b|dimensionless|relative",
    ),
}
CHECKS = (*PATTERNS, *LACKING, "long sentence")
# Sentences longer than this are counted, in words.
LONGEST = 40
# Phrases that a check marks although they read well, by check, each with its reason. None today.
EXCEPTIONS: dict[str, tuple[str, ...]] = {}
# Hits today. A check that is not named here has none, and stays so.
AT_MOST: dict[str, int] = {
    "opens with what": 41,
    "as far as": 4,
    "is none": 43,
    "that of, those of": 353,
    "inversion": 1,
    "tells": 49,
    "all of them": 32,
    "the other": 21,
    "instants": 206,
    "array without a shape": 118,
    "long sentence": 210,
}

Hit = tuple[Text, str]


@cache
def texts(root: Path = ROOT) -> list[Text]:
    return prose(root)


@cache
def hits(root: Path = ROOT) -> dict[str, list[Hit]]:
    """Return the marked texts of every check, each with the words around the mark."""
    found: dict[str, list[Hit]] = {name: [] for name in CHECKS}
    marks = {name: (kinds, re.compile(mark)) for name, (kinds, mark) in PATTERNS.items()}
    needs = {name: (kinds, re.compile(need)) for name, (kinds, need) in LACKING.items()}
    for text in texts(root):
        for name, (kinds, mark) in marks.items():
            if text.kind in kinds:
                found[name] += [(text, near) for near in _near(text.words, mark, name)]
        for name, (kinds, need) in needs.items():
            if (
                text.kind in kinds
                and text.file.startswith("ancfdae")
                and not need.search(text.words)
            ):
                found[name].append((text, " ".join(text.words.split()[:20])))
        if text.kind in ("docstring", "markdown") and "|" not in text.words:
            for sentence in re.split(r"(?<=[.?])\s+|\n\s*\n|\n\s*[-*] ", text.words):
                if len(sentence.split()) > LONGEST:
                    found["long sentence"].append((text, " ".join(sentence.split()[:12])))
    return found


def _near(words: str, mark: re.Pattern[str], name: str) -> list[str]:
    cut = (words[max(0, m.start() - 60) : m.end() + 60] for m in mark.finditer(words))
    near = (" ".join(x.split()) for x in cut)
    return [x for x in near if not any(phrase in x for phrase in EXCEPTIONS.get(name, ()))]


@cache
def earlier() -> dict[str, Counter[str]]:
    """Return the hits at the commit that last changed this file; none without git."""
    this = Path(__file__).relative_to(ROOT).as_posix()
    run = partial(subprocess.run, cwd=ROOT, capture_output=True, check=True)
    try:
        commit = run(["git", "log", "-1", "--format=%H", "--", this], text=True).stdout.strip()
        folders = [x for x in FOLDERS if (ROOT / x).is_dir()]
        packed = run(["git", "archive", commit, "README.md", *folders]).stdout
    except (OSError, subprocess.CalledProcessError):
        return {name: Counter() for name in CHECKS}
    with TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(folder, filter="data")
        found = hits(Path(folder))
    return {name: Counter(near for _, near in found[name]) for name in CHECKS}


def new(name: str) -> list[Hit]:
    """Return the hits that were not there when this file was last changed; all without git."""
    before, added = earlier()[name].copy(), []
    for text, near in hits()[name]:
        before[near] -= 1
        if before[near] < 0:
            added.append((text, near))
    return added


def test_no_sentence_is_added_that_the_guide_would_rewrite():
    """All checks in one case, since every process of the test runner that has one reads all."""
    read = Counter(text.kind for text in texts())
    assert {kind for kind, n in read.items() if n >= 100} == KINDS
    wrong = [words for words in map(_judged, CHECKS) if words]
    if wrong:
        pytest.fail("\n".join(wrong))


def _judged(name: str) -> str:
    """Say how the hits of a check differ from the count allowed; empty if they do not."""
    count, most = len(hits()[name]), AT_MOST.get(name, 0)
    if count > most:
        lines = [f"  {text.file}:{text.line} ({text.kind}): {near}" for text, near in new(name)]
        return f"{name!r}: {count} hits, at most {most} allowed. New:\n" + "\n".join(lines)
    return "" if count == most else f"{name!r}: {count} hits are left: lower AT_MOST to it"


@pytest.mark.parametrize(
    ("name", "bad", "good"),
    [
        ("opens with a pronoun", "Those of both laws.", "Breakpoints of the two laws."),
        ("opens with what", "Return what gives the forces.", "Return the law of the forces."),
        ("so many for a number", "At least so many steps.", "So many steps that it ends."),
        ("'what is' for a noun", "Refuse what is no law.", "Refuse a value that is no law."),
        ("former, latter, dear", "The latter as pairs.", "The pairs."),
        ("but for", "Exact but for round-off.", "Exact to round-off."),
        ("of both", "Names of both.", "Names of both fits."),
        ("hedges", "It hardly depends on E.", "It is stiff rather than soft."),
        ("rule without a subject", "is spatial", "needs a scene in space"),
        ("fragment", "Return K. Without v those of f.", "Return K."),
        ("inversion", "Of a run half is kept.", "Half of a run is kept."),
        ("remedy of three words", "Give such times.", "For example t = 0.1 and 0.2."),
    ],
)
def test_a_check_finds_what_it_is_for(name, bad, good):
    """One sentence before and after by the guide: the pattern separates them."""
    mark = re.compile(PATTERNS[name][1])
    assert _near(bad, mark, name)
    assert not _near(good, mark, name)
