#!/usr/bin/env python3
"""Checks the guide as mdBook has built it, and all Markdown files of the project.

    check_docs.py BOOK [PALPATE]

- Links to files and #anchors must exist, in the pages of the folder BOOK and in the Markdown files.
  Addresses on the network are checked for their form only.
- Every page of the guide is in SUMMARY.md and ends with the page to read next.
- Every path in ARCHITECTURE.md exists.
- With the program PALPATE, every setting and its default are in the guide.
"""

import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "docs" / "guide" / "src"
wrong = []


class Page(HTMLParser):
    """The anchors and links of an HTML page."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links = set(), []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name == "id":
                self.anchors.add(value)
            elif name in ("href", "src") and value:
                self.links.append(value)


class Markdown:
    """The anchors and links of a Markdown file, its includes included."""

    def __init__(self, path):
        include = lambda found: (path.parent / found[1]).read_text()
        text = re.sub(r"\{\{#include (\S+?)\}\}", include, path.read_text())
        text = re.sub(r"^( *)```.*?^\1```", "", text, flags=re.DOTALL | re.MULTILINE)
        headings = re.findall(r"^#+ +(.*?) *$", text, flags=re.MULTILINE)
        plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
        self.anchors = {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in plain}
        self.links = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", text))


def check_links(files, kind):
    """Reads the files, and follows every link of one of them to another."""
    read = {path: kind(path) for path in files}
    for path, page in read.items():
        for link in page.links:
            there = urlsplit(link)
            if there.scheme:
                fine = there.scheme in ("http", "https", "mailto") and (there.netloc or there.path)
            else:
                target = (path.parent / unquote(there.path)).resolve() if there.path else path
                other = read.get(target)
                fine = target.exists() and (
                    not there.fragment or other is None or unquote(there.fragment) in other.anchors
                )
            if not fine:
                wrong.append(f"{path}: the link `{link}` has no target")
    return sum(len(page.links) for page in read.values())


def check_guide():
    summary = (GUIDE / "SUMMARY.md").read_text()
    for page in GUIDE.glob("*.md"):
        if page.name == "SUMMARY.md":
            continue
        if f"({page.name})" not in summary:
            wrong.append(f"{page}: not in SUMMARY.md")
        if not re.fullmatch(r"Next: \[.+\]\(.+\)", page.read_text().splitlines()[-1]):
            wrong.append(f"{page}: the last line is not `Next: [page](…)`")


def check_architecture():
    folder = ROOT
    for line in (ROOT / "ARCHITECTURE.md").read_text().splitlines():
        if line.startswith("#"):  # a heading may name the folder of the paths below it
            found = re.search(r"`(crates/.*/)`", line)
            folder = ROOT / found[1] if found else ROOT
        for path in re.findall(r"`([\w./-]+(?:\.(?:rs|py|pyi|md)|/))`", line):
            if not (folder / path).exists() and not (ROOT / path).exists():
                wrong.append(f"ARCHITECTURE.md: there is no `{path}`")


def plain(value):
    """A number as such, whatever it is written like; anything else in lower case."""
    text = str(value).lower()
    return float(text) if re.fullmatch(r"-?[\d.]+", text) else text


def check_settings(palpate):
    printed = subprocess.run([palpate, "settings"], check=True, capture_output=True, text=True)
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|", (GUIDE / "settings.md").read_text(), re.MULTILINE)
    rows = {key: default.replace("`", "") for key, default in rows}
    keys = re.findall(r"^(?:# )?(\w+) = *(?=.*$)", printed.stdout, re.MULTILINE)
    for key in keys:
        if key not in rows:
            wrong.append(f"settings.md: the setting `{key}` is missing")
    for key in rows.keys() - set(keys):
        wrong.append(f"settings.md: there is no setting `{key}`")
    for section in tomllib.loads(printed.stdout).values():
        for key, value in section.items():
            there = rows.get(key, "").split(" ")[0]  # what is behind it is another estimator's
            value = value if isinstance(value, list) else [value]
            if [plain(part) for part in there.split(",")] != [plain(part) for part in value]:
                wrong.append(f"settings.md: the default of `{key}` is {value}, not `{there}`")


book = Path(sys.argv[1]).resolve()
pages = check_links(sorted(book.rglob("*.html")), lambda path: Page(path.read_text()))
hidden = lambda path: any(part == "target" or part[0] == "." for part in path.relative_to(ROOT).parts)
files = sorted(path for path in ROOT.rglob("*.md") if not hidden(path))
other = check_links(files, Markdown)
check_guide()
check_architecture()
if len(sys.argv) > 2:
    check_settings(sys.argv[2])
for line in wrong:
    print(line, file=sys.stderr)
print(f"{pages} links of the guide and {other} of Markdown files, {len(wrong)} faults")
sys.exit(bool(wrong))
