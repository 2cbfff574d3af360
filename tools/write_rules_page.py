"""Write docs/rules.md from the doctor's table of rules."""

from __future__ import annotations

from pathlib import Path

from vitruvian.hanim.doctor_rules import rules_page

PAGE = Path(__file__).resolve().parent.parent / "docs" / "rules.md"

if __name__ == "__main__":
    PAGE.write_text(rules_page(), encoding="utf-8")
    print(PAGE)
