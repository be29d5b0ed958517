"""Write every generated page: `python -m results.generate`, or `make results`.

Exit code 1, with one line: a claim or a JSON file is wrong. A clean tree stays unchanged: pages follow from the JSON files
and the history of commits alone, and history.csv gets lines only for new results.
"""

from __future__ import annotations

import sys
from pathlib import Path

from results.claims import ROOT, ClaimError, evaluate, load_claims, load_headlines, load_results
from results.hazards_page import hazards_page
from results.limits_page import limits_page
from results.pages import history, insert_block, readme_block, results_page
from results.revision_age import with_age

HISTORY = "results/history.csv"


def pages(root: Path = ROOT) -> dict[str, str]:
    """Return the text of each generated file by its path below root. Raises ClaimError."""
    claims, runs = load_claims(root)
    results = load_results(runs, root)
    outcomes = [with_age(evaluate(claim, results), root) for claim in claims]
    past = root / HISTORY
    return {
        "results/README.md": results_page(outcomes),
        HISTORY: history(past.read_text(encoding="utf-8") if past.exists() else "", outcomes),
        "README.md": insert_block(
            (root / "README.md").read_text(encoding="utf-8"), readme_block(outcomes, load_headlines(claims, root))
        ),
        "docs/hazards.md": hazards_page(results, root),
        "docs/limits.md": limits_page(root),
    }


def main() -> int:
    """Write what differs, and print its path."""
    try:
        generated = pages()
    except ClaimError as error:
        print(f"results: {error}", file=sys.stderr)
        return 1
    for name, text in generated.items():
        path = ROOT / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(f"wrote {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
