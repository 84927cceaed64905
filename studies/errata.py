"""What does each misprint that runs cost, and what does the paper's linearised contact?

    python studies/errata.py

On Table 10; `stiffbeam errata CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("errata", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
