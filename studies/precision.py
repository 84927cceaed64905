"""Which method reaches a given error at least cost, and which tracks the solution longest for its cost?

    python studies/precision.py

On Table 10; `stiffbeam precision CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("precision", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
