"""How fast do neighbouring motions part, and do the schemes part as fast as the exact flow?

    python studies/chaos.py

On Table 10; `stiffbeam chaos CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("chaos", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
