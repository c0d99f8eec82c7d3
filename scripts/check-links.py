"""Checks the links of a folder of HTML pages: files and anchors must exist; other hosts are not asked.

Usage: check-links.py FOLDER
"""

import html.parser
import pathlib
import sys
import urllib.parse


class Page(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.links, self.anchors = [], set()

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name in ("href", "src") and value:
                self.links.append(value)
            if name == "id" or (tag == "a" and name == "name"):
                self.anchors.add(value)


def read(path):
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def target(page, link, folder):
    """The file that a link of `page` leads to."""
    path = urllib.parse.unquote(link)
    file = folder / path.lstrip("/") if path.startswith("/") else page.parent / path
    file = page if not path else file.resolve()
    return file / "index.html" if file.is_dir() else file


folder = pathlib.Path(sys.argv[1]).resolve()
pages = {path.resolve(): read(path) for path in sorted(folder.rglob("*.html"))}
# One page of all pages, for printing, repeats what the others say; the other two have no place.
parts = {path: page for path, page in pages.items()
         if path.name not in ("print.html", "404.html", "toc.html")}
broken, checked = [], 0
for path, page in parts.items():
    for link in page.links:
        parts_of_link = urllib.parse.urlsplit(link)
        if parts_of_link.scheme or parts_of_link.netloc:
            continue
        checked += 1
        file = target(path, parts_of_link.path, folder)
        anchor = urllib.parse.unquote(parts_of_link.fragment)
        if not file.is_file() or folder not in file.parents:
            broken.append(f"{path.relative_to(folder)}: {link} leads nowhere")
        elif anchor and file in pages and anchor not in pages[file].anchors:
            broken.append(f"{path.relative_to(folder)}: {link}: no such heading")
if not parts:
    sys.exit(f"no pages in {folder}")
print(f"{len(parts)} pages, {checked} links within the book, {len(broken)} broken")
sys.exit("\n".join(broken) if broken else 0)
