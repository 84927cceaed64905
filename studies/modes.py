"""How late and how damped does each scheme make each mode of a beam without contact, and is that theory?

    python studies/modes.py

On Table 10; `stiffbeam modes CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("modes", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
