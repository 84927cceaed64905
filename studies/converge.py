"""At which rate does each scheme approach the exact solution, smooth and through contact?

    python studies/converge.py

On Table 10; `stiffbeam converge CASE` asks it of any case. Records and picture go to stiffbeam-output/table10.
"""

from stiffbeam.studies import study

OUT = "stiffbeam-output/table10"

if __name__ == "__main__":
    records = study("converge", "table10", folder=f"{OUT}/journal", jobs=2)
    records.save(OUT)
    print(records.answer)
