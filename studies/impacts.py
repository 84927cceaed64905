"""How far is each scheme's impact count from the truth on Tables 10 to 13, and from which step on is it right?

    python studies/impacts.py

The true counts are those of the multiprecision solutions in reference/. Records and pictures go to
stiffbeam-output/<table>; `stiffbeam impacts CASE` asks it of any other case.
"""

from pathlib import Path

from stiffbeam.studies import study

REFERENCES = Path(__file__).parents[1] / "reference"

if __name__ == "__main__":
    for table in ("table10", "table11", "table12", "table13"):
        out = f"stiffbeam-output/{table}"
        records = study("impacts", table, folder=f"{out}/journal", jobs=2, references=str(REFERENCES))
        records.save(out)
        print(f"{table}: {records.answer}")
